"""Records on disk: Parquet tracks and logs, key frames, shipped files."""
