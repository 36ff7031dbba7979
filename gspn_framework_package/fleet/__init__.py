"""A fleet's history: months of event logs, reduced to tables that can be queried in seconds.

``stay_follower`` reduces the records of a run to rows, ``ingest`` reads logs and passes them to it,
``store`` stores the rows as Parquet files, and ``reports`` queries them through DuckDB
(``database``). ``run_story`` derives the story of one run from its log, and ``story_page`` makes
one HTML file of it.
"""
