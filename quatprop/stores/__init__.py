"""Where bytes are: files of this machine, object stores, ranges of them, temporary copies."""
