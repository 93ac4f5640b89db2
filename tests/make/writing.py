"""Writing attitudes through the package, whole and in one call."""

from quatprop.writers import open_writer


def write_series(path, *parts, kind=None, told=None, **options):
    """Write series, each as one batch, and what is told of them; return the path."""
    with open_writer(path, kind, **options) as writer:
        for part in parts:
            writer.write(part)
        writer.commit({} if told is None else told)
    return path
