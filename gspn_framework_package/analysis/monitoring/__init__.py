"""Predicted against observed: what a run of a plan will show, and the alarm when it shows something
else.

Modules: ``choices``, ``comparison``, ``cusum``, ``hazard``, ``monitor``, ``playing``,
``prediction``, ``streams``.
"""
