"""Exchangeable parts of a net, and its state space with one marking for each orbit of them."""
