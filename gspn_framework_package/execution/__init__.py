"""The token game, the event log, the agreement between robots, and the standalone executor. Nothing
here imports ROS.

Modules: ``actions``, ``agreement``, ``attempts``, ``breakpoints``, ``chance``, ``commands``,
``control_socket``, ``displayed_data``, ``enabled_set``, ``environment``, ``event_functions``,
``event_log``, ``event_watch``, ``firing``, ``function_source``, ``history``, ``history_run``,
``ledger``, ``local_kinds``, ``log_damage``, ``log_entries``, ``log_parts``, ``log_writer``,
``logged_attempts``, ``net_difference``, ``observation``, ``parent_death``, ``phase``,
``plan_change``, ``plan_modules``, ``replayer``, ``rules``, ``seen_firings``, ``simulator``,
``standalone``, ``stored_policy``, ``task_turn``, ``team_messages``, ``team_state``, ``team_tasks``,
``timed_get``, ``token_game``, ``turn``, ``verifier``, ``virtual_time``, ``worker_pool``.
"""
