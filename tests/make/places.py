"""Where the project, its sample logs and the real recordings are."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[2]
SAMPLE_LOGS = ROOT / "sample_logs"
SHARED_LOGS = Path(os.environ.get("QUATPROP_SHARED_LOGS", ROOT.parent / "shared" / "logs"))
