"""Contact laws solved without an engine, exact or with a stated error. Imports `contact` and `contract`."""
