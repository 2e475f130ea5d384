"""Pages, figures and numbers in words: what every report has in common."""
