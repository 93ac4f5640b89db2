"""Writers of tables: text, Arrow and NumPy files."""
