"""Generalized Stochastic Petri Net plans on robot teams: execution, visualisation, analysis.

The layers, inner to outer (an inner one never imports an outer one):

``model``
    net, marking, policy, plan, errors: immutable, no input or output.
``formats``
    readers and writers of files.
``run_net``
    what a plan means while it runs, compiled once.
``analysis``
    structure, state space, Markov chain.
``execution``
    token game, event log, agreement protocol, standalone executor.
``ros``
    the nodes: thin adapters between ROS messages and the core.
``visualizer``, ``world``, ``cli``
    the page, the simulated world, the command line.

The inner five need no ROS.

Also here: ``fleet``, ``making``, ``team``, ``testing``.
"""

from pkgutil import extend_path

# The messages that catkin generates are a package of this same name in the devel space. Without the
# next line, ``python3 -m gspn_framework_package`` started in the checkout would hide them.
__path__ = extend_path(__path__, __name__)

__version__ = "0.2.0"
