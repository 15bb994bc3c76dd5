"""What people look at after a run of columns: the facts of its page, and its figures."""
