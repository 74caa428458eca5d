"""A campaign on the process pool and on a Dask cluster of this machine, in pairs."""
