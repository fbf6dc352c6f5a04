"""Making the samples of a data set, on one process or many."""
