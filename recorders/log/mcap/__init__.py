"""The container: MCAP files, read and written as a log needs them."""
