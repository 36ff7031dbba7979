"""New plans: from templates, and from maps."""
