"""Run folders: identity of a result, its manifest and checkpoint, time series as Parquet or CSV, and reports."""
