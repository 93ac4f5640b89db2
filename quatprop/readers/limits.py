"""What users may set about damaged and hostile logs, by environment variables.

They are for the rare log that is right although it looks wrong, so they are no options of the
commands.
"""

from __future__ import annotations

import os

CHECKSUMS = "QUATPROP_CHECKSUMS"
"""``ignore``: chunks whose checksum is wrong are read all the same."""


def checksums_matter() -> bool:
    """Return whether what has a wrong checksum is left out."""
    return os.environ.get(CHECKSUMS, "").strip().lower() != "ignore"
