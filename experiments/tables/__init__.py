"""What is on disk: schema, Parquet, the folder of a run, its lock. Imports `config`."""
