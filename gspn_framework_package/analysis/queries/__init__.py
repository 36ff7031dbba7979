"""Temporal queries about a net or a plan, in the language of PRISM's properties.

``grammar`` reads them, ``states`` finds the markings in which a formula of CTL holds, ``answers``
answers a query with the engines of the analysis.
"""
