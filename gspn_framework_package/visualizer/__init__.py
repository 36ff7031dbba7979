"""The page: shows a net live, replayed or simulated, in a browser (thesis chapter 5).

Each open net has one hub (:mod:`.hub`), which takes events from one source: the offline simulator,
the standalone executor, the reader of recorded runs or the ROS subscriber. Browsers follow the hub.

Modules: ``activity``, ``analysis_jobs``, ``analysis_worker``, ``app``, ``bag_replay``, ``board``,
``connections``, ``deploying``, ``documents``, ``editing``, ``feedback``, ``fired_follower``,
``fleet_page``, ``guard``, ``hub``, ``layout``, ``live_comparison``, ``named_schemas``, ``openapi``,
``optimise_form``, ``optimised``, ``order_schemas``, ``page_orders``, ``poses``, ``project``,
``reasons``, ``recording``, ``replay``, ``ros_node``, ``ros_poses``, ``ros_prediction``,
``ros_watch``, ``run_marks``, ``run_stories``, ``scene``, ``schemas``, ``serving``, ``session``,
``simulation``, ``simulation_form``, ``standalone_run``, ``streams``, ``team_connection``,
``team_events``, ``team_watch``, ``what_if``, ``zenoh_connection``.
"""
