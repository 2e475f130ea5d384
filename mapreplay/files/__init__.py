"""Files from outside and to outside: written whole or not at all, and told by what they are."""
