"""Runs a robot of a team without ROS: the host of its replica, and the carriers of its messages.

Modules: ``addressing``, ``agent``, ``carrier``, ``clock``, ``commands``, ``deploy_team``,
``deployed_plan``, ``ended_tasks``, ``flood_brake``, ``function_actions``, ``function_sources``,
``host``, ``job_runner``, ``jobs``, ``keys``, ``lanes``, ``log_file``, ``message_filter``,
``operator_client``, ``order_fields``, ``orders``, ``own_process``, ``own_sockets``, ``patience``,
``plan_examination``, ``router``, ``router_wait``, ``run_key``, ``seal``, ``self_report``,
``sides``, ``status_reporter``, ``tcp_patience``, ``verdict``, ``zenoh_body``, ``zenoh_carrier``,
``zenoh_operator``, ``zenoh_session``, ``zenoh_watch``.
"""
