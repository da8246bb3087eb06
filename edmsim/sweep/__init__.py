"""Many cuts from one specification, on the cores of a machine or on a cluster; and the search of settings on them."""
