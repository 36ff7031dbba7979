"""Makes new plans from templates and maps.

Modules: ``map_definitions``, ``plan_folder``, ``restrictions``, ``site_drawing``, ``site_goals``,
``site_map``, ``site_plan``, ``site_policy``, ``site_tasks``, ``site_team``, ``templates``.
"""
