"""Makes new plans from templates, maps and behaviour trees.

Modules: ``behaviour_tree``, ``map_definitions``, ``plan_folder``, ``restrictions``,
``site_drawing``, ``site_goals``, ``site_map``, ``site_names``, ``site_plan``, ``site_policy``,
``site_tasks``, ``site_team``, ``templates``.
"""
