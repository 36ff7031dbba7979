"""The page: shows a net live, replayed or simulated, in a browser (thesis chapter 5).

Each open net has one hub (:mod:`.hub`), which takes events from one source: the offline simulator,
the standalone executor, the reader of recorded runs or the ROS subscriber. Browsers follow the hub.
"""
