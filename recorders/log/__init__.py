"""A log: one episode as one MCAP file, written, read, found and recovered."""
