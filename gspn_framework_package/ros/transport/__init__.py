"""Workarounds for rospy and the reasons for them; the only folder that touches rospy's internals.

Everything else in ``ros/`` uses only the documented interface of rospy and actionlib. rospy is
frozen: Noetic is the last ROS 1. Each module below works around one fault of rospy or roslaunch
that affects a team of robots. The list names the internals that it touches and the sign that it is
no longer needed. To remove a module, restore rospy's own code and run the named test.

``registration``
    *Fault:* rospy calls the master once for each topic and service, sequentially and without a time
    limit. A robot with a thousand action servers took over a minute to start; a master that
    hangs holds the caller indefinitely.
    *Touches:* ``rospy.impl.registration``: temporarily removes ``RegManager`` from the list of
    ``get_registration_listeners()``, calls the master itself (one ``MultiCall`` for up to 500
    registrations), and passes publishers to ``RegManager.publisher_update``. Calls that only query
    the master use ``master_proxy``, which has a time limit.
    *No longer needed when* ``rospy.Publisher`` in a loop of 5,000 topics takes seconds, and
    ``rospy.get_published_topics`` has a timeout.
``eager_publisher``
    *Fault:* ``Publisher(queue_size=n)`` starts a thread for each subscriber; without a queue, one
    stuck subscriber blocks all others.
    *Touches:* ``rospy.topics._PublisherImpl``: sets its ``queue_size`` to None and wraps the
    argument of ``add_connection``; reads ``done`` and ``socket`` of the transport, and updates its
    counters.
    *No longer needed when* ``test/unit/ros/test_eager_publisher.py`` passes with
    ``rospy.Publisher``.
``shared_reader``
    *Fault:* a subscriber has a thread for each publisher: in a team of 30, about 30 for each robot,
    which took a tenth of its memory.
    *Touches:* ``rospy.topics._SubscriberImpl``: wraps the argument of ``add_connection``;
    ``rospy.impl.tcpros_base.TCPROSTransport``: replaces ``receive_loop`` of a connection, and does
    the work of ``receive_once``.
    *No longer needed when* the memory and the threads of a large team do not matter.
``service_calls``
    *Fault:* ``ServiceProxy`` queries the master at every call, and waits indefinitely for a stopped
    process.
    *Touches:* ``rospy.impl.tcpros_base.TCPROSTransport`` and
    ``rospy.impl.tcpros_service.TCPROSServiceClient``, from which it builds the connection itself;
    ``rospy.core.parse_rosrpc_uri``.
    *No longer needed when* ``ServiceProxy`` takes a deadline and an address.
``master_watch``
    *Fault:* a node does not register again after the master has restarted.
    *Touches:* ``rospy.impl.registration``: reads the lists of the topic manager and the service
    manager.
    *No longer needed when* ``rosnode list`` shows a node that kept running while ``roscore`` was
    restarted (``test/rostest/faults``).
``node_process``
    *Faults:* ``init_node`` fails without a master; it queues only five pending connections, so a
    team that starts all at once loses some for seconds; a publisher announced twice in a moment is
    connected twice and disconnected once; after ``rosnode kill`` the process may end
    before the node is unregistered; every log line queries the master for a parameter, without a
    time limit; a forked process keeps the name of its parent; threads that lose their socket at the
    end print tracebacks.
    *Touches:* ``rospy.impl.tcpros_base._tcpros_server`` (its ``server_sock``),
    ``rospy.impl.masterslave.ROSHandler._connect_topic``,
    ``rospy.core._shutdown_lock``, ``rospy.impl.paramserver.get_param_server_cache``,
    ``rospy.impl.rosout.RosOutHandler``, ``rospy.names._set_caller_id`` and ``reload_mappings``,
    ``threading.excepthook``.
    *No longer needed when* ``test/unit/ros/test_node_process.py``, ``test/rostest/faults`` and a
    start of fifty robots pass without it; this can be tried for each function separately.
``process_family``
    *Fault:* roslaunch starts every node as a new interpreter, which imports everything and reads
    the plan again. Here one process does that once and then forks; the robots share its memory
    (``docs/benchmarks.md``). After that it only waits, as a program without any libraries.
    *Touches:* nothing in rospy, but relies on two facts: importing rospy starts no thread, and a
    process forked before ``init_node`` can become a separate node (``node_process.be_node``).
    *No longer needed when* the memory and start-up time of one Python process per robot do not
    matter.
``ending``
    *Fault:* ``threading.Event`` can deadlock when a signal handler calls ``set()`` during another
    ``set()``; roslaunch and ``gspn_team`` send two signals at once.
    *Touches:* nothing in rospy: the nodes run with ``disable_signals=True``.
    *No longer needed when* ``test/unit/ros/test_ending.py`` passes with ``threading.Event``.

Also here: ``service_call``.
"""
