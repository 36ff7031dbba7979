"""Values that others published, computed anew: ``python3 -m benchmarks.literature``.

=================  ============================================================================
``answers``        our answer to a question about a net, with its interval
``chains``         Markov chains of the literature as nets: cluster, tandem, embedded and others
``choices``        decision problems of the literature as nets with choices
``comparing``      compares our answers with the published ones, in processes
``published``      the published values, read from ``published.txt``
``questions``      what is asked about each family of nets
=================  ============================================================================
"""
