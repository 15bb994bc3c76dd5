"""Files of a run: schema, Parquet, the folder with its locks. Imports `config`."""
