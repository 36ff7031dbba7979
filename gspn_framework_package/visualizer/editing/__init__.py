"""Editing of plans in the page: the server's side. It is off unless the operator asks for it.

Modules: ``atomic``, ``belongings``, ``check_worker``, ``check_workers``, ``choices``, ``drafts``,
``export``, ``findings``, ``help_routes``, ``open_document``, ``palette``, ``routes``, ``saving``,
``workshop``.
"""
