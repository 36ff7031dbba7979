"""The page: a net live, replayed and simulated, in a browser (thesis chapter 5).

One hub per open net (:mod:`.hub`) takes events from one source: the offline simulator, the
standalone executor, the reader of recorded runs, the ROS subscriber. Browsers follow it.
"""
