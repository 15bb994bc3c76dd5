"""The command line ``impact-xval``, with one module for each group of commands."""
