"""Sources of bytes: local files, object stores, byte ranges, temporary copies."""
