"""Processes that we start, and that end with the one that started them."""
