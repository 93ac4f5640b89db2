"""One log from opening it to the committed output and its report."""
