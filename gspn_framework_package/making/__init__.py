"""Makes new plans from templates, maps, behaviour trees and state machines.

Modules: ``behaviour_tree``, ``leaf_plan``, ``map_definitions``, ``plan_folder``, ``python_file``,
``python_machine``, ``python_tree``, ``restrictions``, ``site_drawing``, ``site_elements``,
``site_goals``, ``site_groups``, ``site_map``, ``site_names``, ``site_plan``, ``site_policy``,
``site_tasks``, ``site_team``, ``site_traffic``, ``templates``.
"""
