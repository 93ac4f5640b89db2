"""From what a log holds to series: body rates in rad/s, attitudes wxyz, at stamps in ns."""
