"""Plans of data sets and the recipes of their samples."""
