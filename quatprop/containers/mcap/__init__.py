"""MCAP files: records, chunks and indexes, whole or damaged."""
