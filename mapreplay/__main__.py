"""``python -m mapreplay``."""

from mapreplay.cli import main

main()
