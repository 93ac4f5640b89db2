"""Tables of rates and attitudes as text, with one call."""

import numpy as np


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


def write_frame(path, frame, group):
    """Write a data frame in the format of a file's suffix; return the path.

    `group`: rows of a row group, in Parquet
    """
    match path.suffix:
        case ".csv":
            frame.to_csv(path, index=False)
        case ".jsonl":
            frame.to_json(path, orient="records", lines=True)
        case ".parquet":
            frame.to_parquet(path, row_group_size=group)
        case ".npy":
            np.save(path, frame.to_records(index=False))
    return path
