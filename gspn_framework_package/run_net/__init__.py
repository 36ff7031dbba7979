"""What a plan means while it runs, compiled once: a *run net*, which the analysis reads.

* ``compiling``: from a plan to its run net;
* ``run_net``: the columns in which its robots are, and what takes them from one to the next;
* ``columns``: the columns of an action place, and what its robots are up to in each;
* ``steps``: what happens in a state of a run net under the plan's policy, with rates and
  probabilities;
* ``requests``: what a robot draws from, and which of several requests fires first;
* ``literal``: a run net as an ordinary net, for other tools and for people, with ``staged_net``,
  a net as it is being built, and ``ending``, when a condition holds, as bounds on tokens;
* ``phases``: durations as exponential phases, and ``size``: how many states these make.
"""
