"""Make a page about the quality of a dataset, before a training uses it."""
