"""A fleet's history: months of event logs, reduced to tables that are asked in seconds.

``stay_follower`` reduces the records of a run to rows, ``ingest`` reads logs and has it do that,
``store`` keeps the rows as Parquet files, and ``reports`` asks them through DuckDB (``database``).
"""
