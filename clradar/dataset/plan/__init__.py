"""Plans of data sets, and the recipes of samples that follow from them."""
