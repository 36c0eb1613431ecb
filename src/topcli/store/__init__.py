"""Run folders: time series as Parquet or CSV, reports, and the manifest written last."""
