"""Run the command line as ``python -m quatprop``."""

from quatprop.cli import main

if __name__ == "__main__":
    main()
