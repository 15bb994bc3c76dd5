"""The commands on one contact: in the terms of an engine, and from materials."""
