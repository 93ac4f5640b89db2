"""Small logs, attitudes and odd files, under the names that command lines of tests give them."""

import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from make.commands import run
from make.places import SAMPLE_LOGS
from make.ros import imu_messages, write_messages
from make.tables import write_attitudes, write_rates

EUROC = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]"
QUATERNION = "t_ns,qw,qx,qy,qz"
ATTITUDES = f"{QUATERNION}\n1,1,0,0,0\n2,0.8,0.6,0,0\n"
EPOCH_NS = 1_700_000_000_000_000_000
TOPICS = ("/one", "/two")

TEXTS = {
    "nan.csv": "t_ns,wx,wy,wz\n0,0,0,nan\n1000000,0,0,1\n",
    "nameless.csv": "t_ns,gx,gy,gz\n0,0,0,1\n1000000,0,0,1\n",
    "both.csv": "t_ns,wx,wy,wz,qw,qx,qy,qz\n0,0,0,1,1,0,0,0\n9,0,0,1,1,0,0,0\n",
    "q.csv": ATTITUDES,
    "q0.csv": f"{QUATERNION}\n-1,1,0,0,0\n1000000000000,1,0,0,0\n",
    "zeros.csv": f"{ATTITUDES}3,0,0,0,0\n",
    "absent.csv": f"{QUATERNION}\n1,nan,nan,nan,nan\n2,nan,nan,nan,nan\n",
    "header.csv": f"{QUATERNION}\n",
    "no_rates.csv": "t_ns,wx,wy,wz\n",
    "plain.csv": "1,1,0,0,0\n2,1,0,0,0\n",
    "old.csv": "old",
    "old.png": "old",
    "q.svg": ATTITUDES,
    "weather.csv": "time,temperature,pressure\n0,20,1\n1,21,1\n",
    "angles.csv": "t_ns,yaw,pitch,roll\n0,1,0,0\n1,1,0,0\n",
    "empty.mcap": "",
    "odd.xyz": "\x00\x01\x02 nonsense",
    "locked.csv": "old",
    "at_seconds.csv": "0.5\n",
    "at_word.csv": "t_ns\n1\nx\n",
    "at_header.csv": "t_ns\n",
    "huge.csv": "t_ns,wx_rad_s,wy_rad_s,wz_rad_s\n0,1e308,1e308,0\n1,0,0,0\n",
    "a.kitti": "1 0 0 0 0 1 0 0 0 0 1 0\n",
    "b.kitti": "1 0 0 0\n",
    "typo.toml": "metod = 'end'",
    "output.toml": "output = 'x.csv'",
    "method.toml": "method = 'rk4'",
    "unit.toml": "max-gap = 5_000_000",
    "broken.toml": "method",
    "number.toml": "sigma = 1",
    "text.toml": "quiet = 'no'",
}


def write_small_files(folder):
    """Write all of them into a folder; return it."""
    for name, first_ns in (("log.csv", 0), ("epoch.csv", EPOCH_NS)):
        rows = [(first_ns + 100_000_000 * k, 0, 0, 1) for k in range(11)]
        write_rates(folder / name, rows, EUROC)
    angle = np.arange(100) * 0.01
    wxyz = np.column_stack([np.cos(angle), 0 * angle, 0 * angle, np.sin(angle)])
    write_attitudes(folder / "spin.csv", np.arange(100) * 10_000_000, wxyz)
    for name, text in TEXTS.items():
        (folder / name).write_text(text)
    (folder / "folder.csv").mkdir()
    (folder / "link.csv").symlink_to("q.csv")
    shutil.copytree(SAMPLE_LOGS / "tumbling_ros2", folder / "bag")
    names = ("/cam/imu", "/imu_raw")
    rates = [(name, *one[1:]) for name in names for one in imu_messages(range(3))]
    write_messages(folder / "gyros.bag", rates)
    kind, values = "geometry_msgs/msg/QuaternionStamped", {"quaternion": (0.0, 0.0, 0.0, 1.0)}
    turns = [(name, kind, k, {"header": {"stamp": k}, **values}) for k in (1, 2) for name in TOPICS]
    write_messages(folder / "two.mcap", turns)
    run("convert", folder / "q.csv", folder / "jpl.parquet", "--convention", "jpl", code=0)
    said = json.dumps({"convention": {"layout": "scalar-first"}})
    for name, columns, metadata in (
        ("swapped.parquet", ("qx", "qy", "qz", "qw"), said),
        ("damaged.parquet", ("qw", "qx", "qy", "qz"), "{"),
        ("height.parquet", ("height",), "{}"),
        ("escapes.parquet", ("\x1b[31mred",), "{}"),
    ):
        table = pa.table({"t_ns": [0, 1], **{column: np.eye(2)[0] for column in columns}})
        pq.write_table(table.replace_schema_metadata({"quatprop": metadata}), folder / name)
    (folder / "locked").mkdir()
    for name, mode in (("locked.csv", 0o444), ("locked", 0o555)):
        (folder / name).chmod(mode)
    return folder
