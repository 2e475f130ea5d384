"""Pages, figures and numbers in words: shared by all reports."""
