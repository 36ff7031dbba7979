"""Editing of plans in the page: the server's side. It is off unless the operator asks for it."""
