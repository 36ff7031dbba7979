"""Predicted against observed: predictions for a run of a plan, and alarms when a run departs from
them.

Modules: ``choices``, ``comparison``, ``cusum``, ``differences``, ``hazard``, ``monitor``,
``playing``, ``prediction``, ``streams``.
"""
