"""Runs that make samples in one process or on a Dask cluster; replay, and estimate of cost."""
