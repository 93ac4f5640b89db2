"""Tables of rates and attitudes as text, with one call."""


def write_rates(path, rows, head="t_ns,wx,wy,wz"):
    """Write rows under a head; return the path."""
    lines = [row if isinstance(row, str) else ",".join(map(str, row)) for row in rows]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([head, *lines]) + "\n")
    return path


def write_attitudes(path, t_ns, wxyz, head="t_ns,qw,qx,qy,qz"):
    """Write stamps and quaternions with all their digits; return the path."""
    rows = zip(t_ns, wxyz, strict=True)
    return write_rates(path, [[int(t), *map(float, q)] for t, q in rows], head)
