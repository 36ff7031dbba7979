"""Editing of plans in the page: the server's side. It is off unless the operator asks for it.

Modules: ``atomic``, ``check_worker``, ``check_workers``, ``choices``, ``drafts``, ``export``,
``findings``, ``functions``, ``help_routes``, ``open_document``, ``palette``, ``plan_files``,
``plan_repository``, ``routes``, ``saving``, ``sharing``.
"""
