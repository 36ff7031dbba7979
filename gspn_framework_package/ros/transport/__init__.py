"""What this package does to rospy, and why: the only folder that touches rospy's internals.

Everything else in ``ros/`` keeps to the documented interface of rospy and actionlib. rospy is
frozen: Noetic is the last ROS 1. Each module below stands for one fault of rospy or roslaunch that
a team of robots meets; it names the internals that it touches, and how to see that it is no longer
needed. Remove a module by putting rospy's own back and running the test that is named.

``registration``
    *Fault:* rospy calls the master once for each topic and service, one after the other, without a
    time limit. A robot with a thousand action servers took over a minute to start; a master that
    hangs holds the caller indefinitely.
    *Touches:* ``rospy.impl.registration``: takes ``RegManager`` off the list of
    ``get_registration_listeners()`` for a while, calls the master itself (one ``MultiCall``), hands
    publishers to ``RegManager.publisher_update``. Calls that only ask the master use
    ``master_proxy``, which has a time limit.
    *No longer needed when* ``rospy.Publisher`` in a loop of 5,000 topics takes seconds, and
    ``rospy.get_published_topics`` has a timeout.
``eager_publisher``
    *Fault:* ``Publisher(queue_size=n)`` starts a thread for each subscriber; without a queue one
    subscriber that is stuck holds up all others.
    *Touches:* ``rospy.topics._PublisherImpl``: sets its ``queue_size`` to None and wraps what
    ``add_connection`` is given; reads ``done``, ``socket`` and the counters of the transport.
    *No longer needed when* ``test/unit/ros/test_eager_publisher.py`` passes with
    ``rospy.Publisher``.
``service_calls``
    *Fault:* ``ServiceProxy`` asks the master at every call, and waits without end for a stopped
    process.
    *Touches:* ``rospy.impl.tcpros_base.TCPROSTransport`` and
    ``rospy.impl.tcpros_service.TCPROSServiceClient``, from which it builds the connection itself;
    ``rospy.core.parse_rosrpc_uri``.
    *No longer needed when* ``ServiceProxy`` takes a deadline and an address.
``master_watch``
    *Fault:* a node does not register again after the master was restarted.
    *Touches:* ``rospy.impl.registration``: reads the lists of the topic manager and the service
    manager.
    *No longer needed when* ``rosnode list`` shows a node again that was running while ``roscore``
    was restarted (``test/rostest/faults``).
``node_process``
    *Faults:* ``init_node`` fails without a master; it allows five connections to wait, so that a
    team that starts at once loses some for seconds; after ``rosnode kill`` the process may end
    before the node is unregistered; every line of the log asks the master for a parameter, without
    a time limit; a forked process keeps the name of its parent; threads that lose their socket at
    the end print tracebacks.
    *Touches:* ``rospy.impl.tcpros_base._tcpros_server`` (its ``server_sock``),
    ``rospy.core._shutdown_lock``, ``rospy.impl.paramserver.get_param_server_cache``,
    ``rospy.impl.rosout.RosOutHandler``, ``rospy.names._set_caller_id`` and ``reload_mappings``,
    ``threading.excepthook``.
    *No longer needed when* each function, taken out by itself, changes nothing in
    ``test/unit/ros/test_node_process.py``, ``test/rostest/faults`` and a start of fifty robots.
``process_family``
    *Fault:* roslaunch starts every node as a new interpreter, which imports everything and reads
    the plan again. Here one process does that once, then forks; the robots share its memory
    (``docs/benchmarks.md``).
    *Touches:* nothing of rospy, but relies on it: importing rospy starts no thread, and a process
    that was forked before ``init_node`` can become a separate node (``node_process.be_node``).
    *No longer needed when* memory and time for a Python process per robot do not matter.
``ending``
    *Fault:* ``threading.Event`` can deadlock when a signal handler calls ``set()`` during another
    ``set()``; roslaunch and ``gspn_team`` send two signals at once.
    *Touches:* nothing of rospy: its nodes run with ``disable_signals=True``.
    *No longer needed when* ``test/unit/ros/test_ending.py`` passes with ``threading.Event``.
"""
