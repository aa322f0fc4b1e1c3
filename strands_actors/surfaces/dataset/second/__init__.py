"""Copy the finished episodes of a dataset to a second place: another folder, an object store, or the Hub."""
