"""The other commands: a folder or a module each."""
