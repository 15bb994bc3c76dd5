"""Configuration of an experiment: the TOML file and its validation, the axes, the cells, and options of commands."""
