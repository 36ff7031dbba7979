"""The ROS layer: thin adapters between ROS messages and the core. Callbacks only enqueue.

Modules: ``action_caller``, ``action_connection``, ``action_kinds``, ``action_targets``,
``check_all``, ``diagnostics``, ``direct_connection``, ``event_sources``, ``execution_node``,
``facts``, ``goal_data``, ``goal_id``, ``goal_state``, ``inbound``, ``links``, ``live_graph``,
``message_fields``, ``messages``, ``network_fault``, ``node_main``, ``node_services``, ``options``,
``place_servers``, ``recorded_messages``, ``robot_actions``, ``ros_clock``, ``service_line``,
``team_markers``, ``team_monitor``, ``team_view``, ``thesis_interface``, ``transport``,
``zenoh_transport``.
"""
