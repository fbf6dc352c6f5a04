"""Statistics and contact sheet of a complete data set."""
