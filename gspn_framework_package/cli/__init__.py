"""The command line: one module per verb, started by :mod:`gspn_framework_package.cli.main`.

Modules: ``against``, ``agent``, ``aims``, ``analyse``, ``analysis_text``, ``breakpoints``,
``build``, ``check``, ``compare``, ``completion``, ``continued``, ``convert``, ``deadlock_free``,
``demo``, ``deploy``, ``diff``, ``draw``, ``explain``, ``export``, ``film``, ``fit``, ``history``,
``history_options``, ``importing``, ``improve``, ``interrupts``, ``keys``, ``limits``, ``main``,
``man``, ``mcp``, ``mcp_resources``, ``mcp_server``, ``mcp_tools``, ``memory``, ``net_input``,
``new``, ``numbers``, ``on_history``, ``optimise``, ``options``, ``orders``, ``plan_output``,
``plot``, ``progress``, ``proofs``, ``queries``, ``replay``, ``report``, ``room``, ``router``,
``run``, ``serve``, ``simulate``, ``simulated_runs``, ``status``, ``sweep``, ``sweep_figure``,
``sweep_store``, ``table``, ``tasks``, ``team_client``, ``trust``, ``verify``, ``virtual_log``.
"""
