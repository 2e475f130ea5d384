"""Episodes in Rerun: in a window, a browser, a file or a notebook."""
