"""Refusals: exit code 2, one sentence, and no file is written or changed."""

import shlex

import pytest
from make.commands import begins, refused
from make.small_files import ATTITUDES, write_small_files

from quatprop.stores.kinds import READERS
from quatprop.writers.formats import GENERAL_KINDS

INPUT = "this is an input of the run; choose another output"
TWICE = "two outputs of the run would go here; choose another"
RATE = "is not a rate from 1e-9 to 1e9 Hz; write 100, 29.97 or 30000/1001"
NO_TIME = "is not a time; write RFC 3339 (2024-01-31T12:00:00Z) or integer nanoseconds"
ODD = "neither its content nor its suffix is one that this version reads; if you know its kind"
EUROC_COLUMNS = "'w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]'"
COUNTED = (
    "counts from the first sample, and no log is so long; write a Unix time as RFC 3339 "
    "(2024-01-31T12:00:00Z) or in ns, without a unit"
)
IN_NS = "a number without a unit is in ns: write all digits, a date, or a duration from the first"
KIND = "omit --from, or name the log itself"
ONCE = "Error: stdin can be read only once; name files for the others"
TWO_TOPICS = "Error: two.mcap: several topics carry attitudes: '/one', '/two'; choose one with"
SIMULATED = "|".join(GENERAL_KINDS)

GO = "name the output: -o OUT"
NO_SERIES = "is not four numbers W,X,Y,Z, level, log, a file"
ONE_TOPIC = "is given 2 times, and one topic is read; run the command once"
TOPICS = "another topic is given, '/imu_raw'; name one"

PROPAGATE = {
    "none.mcap": "Error: none.mcap: no such file or folder; check the path",
    "empty.mcap": "Error: empty.mcap: the file is empty; was the recording closed?",
    "odd.xyz": f"{ODD}, use --from {'|'.join(READERS)}",
    "weather.csv": "no body rates found; its columns are 'time', 'temperature', 'pressure'; name "
    "the columns with --rate-cols and --time-col",
    "log.csv -o out.xls": "Error: out.xls: the suffix does not determine the output format; use "
    "one of",
    "log.csv -o folder.csv": "Error: folder.csv: is a folder; name a file in it",
    "log.csv -o log.csv": f"Error: log.csv: {INPUT}",
    "log.csv --report log.csv": f"Error: log.csv: {INPUT}",
    "log.csv -o q0.csv --q0 q0.csv": f"Error: q0.csv: {INPUT}",
    "log.csv --report out.csv": f"Error: out.csv: {TWICE}",
    "log.csv --plot out.svg --to csv -o out.svg": f"Error: out.svg: {TWICE}",
    "bag -o bag/out.csv": "this is in ...bag, which is an input; choose another output",
    "log.csv -o old.csv --report none/report.json": "there is no folder",
    "log.csv -o locked.csv": "Error: locked.csv: this file is read-only; choose another",
    "log.csv -o locked/out.csv": "writing in the folder ...locked is not permitted; choose another",
    "log.csv -o - --report -": "Error: -: two outputs of the run would go to stdout; name a file",
    "nan.csv -o old.csv": "the rate of sample 0 (t = 0 ns) is absent or not finite",
    "huge.csv": "Error: huge.csv: the attitude of sample 1 is not finite; rates must be finite, "
    "and their squares too; omit others with --start and --end",
    **{
        f"nan.csv -o - --to {kind}": "the rate of sample 0 (t = 0 ns) is absent or not finite"
        for kind in ("csv", "tsv", "jsonl", "tum")
    },
    "log.csv --heading 30": "--heading requires --q0",
    "log.csv --reference-z down": "--reference-z requires --q0",
    "log.csv --q0-layout xyzw": "--q0-layout requires --q0",
    "log.csv --q0 0,0,0,0": "--q0 0.0,0.0,0.0,0.0 has the length 0, so it is not an attitude; "
    "the identity is 1,0,0,0",
    "log.csv --q0 1,0,0,0.1": "--q0 1.0,0.0,0.0,0.1 has the length 1.00499, so it is not an attit",
    "log.csv --start noon": "Invalid value for '--start': 'noon' is not a time",
    "log.csv --rate 0": f"'0' {RATE}",
    "log.csv --rate 3 --every 2": "--every, --rate and --at each say which attitudes to write; ch",
    "log.csv --at ''": "Invalid value for '--at': ",
    "log.csv --report ''": "Invalid value for '--report': the name is empty; is a variable of the",
    "log.csv --method middle": "Invalid value for '--method': 'middle' is not one of",
    "log.csv --method conning": "'conning' is not one of 'start', ... 'quintic'; did you mean "
    "'coning'?",
    "log.csv --with euler-zyx,rotvec": "'euler-zyx,rotvec' names several, and only one is poss",
    "log.csv --bias static:neares": "'neares' is not a duration; write a number with a unit, such "
    "as 20ms, 0.5s or 1m30s; did you mean 'nearest'?",
    "log.csv --bias static@+1s": "'static@+1s' is not a time range; write static@+10s..+20s",
    "log.csv --bias static@+1s..": "'static@+1s..' is not a time range; write static@+10s..+20s",
    "log.csv --bias static@+1s..soon": "'soon'",
    "log.csv --bias static@+9s..+1s": "--bias static@+9000000000ns..+1000000000ns holds "
    "fewer than 2 samples; info shows where the log begins",
    "log.csv --mount 2,0,0,0": "the mounting '2,0,0,0' has the length 2, so it is not a rotation",
    "log.csv --start 2000000000": f"Error: log.csv: no samples in {EUROC_COLUMNS} between --start "
    "and --end: 11 are before, 0 after; a number without a unit is in ns",
    # The units were doubted where they had been given.
    "log.csv --start +500s": "no samples in 'w_RS_S_x [rad s^-1],w_RS_S_y ... 11 are before, 0 "
    "after; the log is 1 s long",
    "log.csv --start +2s --end 500000000": "--start is 1.5 s after --end; swap them, or check un",
    # They counted from the first sample, 45 years, and left nothing out.
    "log.csv --start 1408542250s": f"'1408542250s' {COUNTED}",
    "log.csv --end +1408542250.25s": f"'+1408542250.25s' {COUNTED}",
    "log.csv --end 391262h": f"'391262h' {COUNTED}",
    "epoch.csv --start 1700000001": "Error: --start is at 1700000001 ns, and the first sample at "
    f"1700000000000000000 ns; {IN_NS}",
    "epoch.csv --start 1700000000001": "--start is at 1700000000001 ns, and the first sample at",
    "log.csv -o out.bag --frames map": "--frames 'map' is not two names; write REFERENCE,BODY",
    **{
        f"log.csv -o out.{name} --layout {layout}": "... is scalar-last by its own definition"
        for name in ("tum", "mcap", "bag")
        for layout in ("scalar-first", "wxyz")
    },
    "log.csv --config typo.toml": "no such key 'metod'; did you mean 'method'?",
    "log.csv --config output.toml": "no such key 'output'; ",
    "log.csv --config method.toml": "Invalid value for '--method': 'rk4' is not one of",
    "log.csv --config unit.toml": "Invalid value for '--max-gap': '5000000' without a unit is in "
    "seconds; write 5000000ns, or 5000000s if",
    "log.csv --config broken.toml": "it is not TOML: ",
    "log.csv --config /dev/zero": "/dev/zero: it is too large; 67,108,864 bytes are read at most",
    "log.csv --config none.toml": "no such file or folder; check the path",
    "log.csv --config number.toml": "Error: number.toml: 'sigma' is true or false, not 1",
    "log.csv --config text.toml": "Error: text.toml: 'quiet' is true or false, not 'no'",
    "log.csv --metod x": "Error: No such option '--metod'; did you mean '--method'?",
    "log.csv --on-gaps x": "No such option '--on-gaps'; did you mean '--on-gap'?",
    "log.csv --zzz": "Error: No such option '--zzz'",
    "gyros.bag -t imu": "no topic 'imu' that carries body rates; ... one of '/cam/imu', "
    "'/imu_raw'; did you mean '/cam/imu'?",
    "gyros.bag -t /imuraw": "no topic '/imuraw' that carries body rates; ... did you mean "
    "'/imu_raw'?",
    "gyros.bag -t /imu_raw --time-field header.stmp": "'sensor_msgs/msg/Imu' has no field "
    "'header.stmp'; ... has 'seq', 'stamp', 'frame_id'; did you me",
    "gyros.bag:/cam/imu -t /imu_raw": f"Error: gyros.bag:/cam/imu: {TOPICS}",
    "gyros.bag:/imu_raw gyros.bag:/cam/imu": f"Error: gyros.bag:/cam/imu: {TOPICS}",
    # The last was read, and the first was ignored without a message.
    "gyros.bag -t /imu_raw --topic /cam/imu": f"--topic {ONE_TOPIC}",
    "two.mcap --rate-field omega": "no message has a field 'omega'; the topics are '/one (geom",
    "log.csv --q0 /vicon": f"--q0 /vicon {NO_SERIES}",
    "log.csv --q0 levle": f"--q0 levle {NO_SERIES}",
    "bag --q0 /imu": "'/imu' has no orientation: 1000 of 1000 rows are invalid quaternions (1000 ",
    "log.csv --at at_seconds.csv": "line 1: '0.5' is not a timestamp; write RFC 3339 or whole ns",
    "log.csv --at at_word.csv": "line 3: 'x' is not a timestamp",
    "log.csv --at at_header.csv": "Error: --at at_header.csv holds no timestamps",
    # The sentence had no beginning.
    "log.csv --at header.csv": "Error: --at header.csv holds no timestamps",
    "- --q0 level": "stdin can be read only once",
    "nameless.csv --rate-unit rad/s --rate-cols gx,gy,gzz": "--rate-cols asks for column 'gzz'; "
    "... 'gx', 'gy', 'gz'; did you mean 'gz'?",
}

BATCH = {
    "- -o out": "stdin is one log; give it to quatprop propagate",
    "log.csv -o out -j 2 --dask tcp://x:1": "-j is for this machine; omit it with",
    "log.csv -o out --verify": "--verify requires --skip-existing",
    "log.csv -o out --heading 5": "--heading requires --q0 level",
    "log.csv -o log.csv": "-o log.csv is a file; name a folder for the outputs",
    ". -o .": "outputs in '.' would lie among the logs; choose --output",
    "log.csv -o out --sigma": "--sigma needs the errors of the gyroscope; give",
    "-o out": "Error: there are no logs; name files, folders or patterns, or use --list",
    "folder.csv -o out": "Error: there are no logs in 'folder.csv'; name files",
}

SIMULATE = {
    "s.csv --truth s.csv": f"Error: s.csv: {TWICE}",
    "a.csv --rate fast": f"Invalid value for '--rate': 'fast' {RATE}",
    "a.csv --angle wide": "Invalid value for '--angle': 'wide' is not a number",
    "a.csv --seed -1": "Invalid value for '--seed': '-1' is not a whole number from 0 on",
    "a.csv --start +10s": f"'+10s' {NO_TIME}",
    "a.csv --duration 0s": "'0s' is not a duration above 0",
    "a.csv --samples 5 --duration 1s": "--samples and --duration exclude each other; give one of",
    "a.csv --motion coning --axis 1,0,0": "--axis requires --motion spin",
    "a.csv --angle 5": "--angle requires --motion coning or tumbling",
    "a.csv --motion rest --walk 1": "--walk requires --motion random-walk",
    "a.bag --compression zstd": "a bag log cannot be compressed with 'zstd'; choose 'none', 'lz4'",
    "a.tum": "kind 'tum' holds attitudes only; choose 'csv', 'tsv',",
    # The first two have no name, which was a bug.
    **{place: f"Error: {place}: exists already; choose another" for place in (".", "/", "bag")},
    "a.ulg": "the suffix does not determine the output format; use one of .csv, ... .npz, .mcap, "
    f".bag, none for a ROS 2 bag folder, or specify --to {SIMULATED}",
}

COMPARE = {
    "spin.csv spin.csv q.csv": "unexpected argument 'q.csv'; compare takes A B: run it once for",
    "spin.csv spin.csv --tol 0.1": "'0.1' is not an angle; write a number with its unit, such as ",
    "spin.csv spin.csv --time-offset soon": "'soon' is not a duration; write a number with a unit",
    "spin.csv spin.csv --time-offset auto": "the speed of A is constant, which shows no time",
    "spin.csv spin.csv --align mount": "the body turns about one axis only",
    "spin.csv spin.csv --window 1h": "no two pairs are 3600 s apart: they span 990 ms",
    "spin.csv spin.csv --quat-cols-b qw,qx": "'qw,qx' does not name 3 or 4 columns A,B,C[,D]",
    "spin.csv spin.csv --topic-b /imu": "--topic-b is for logs of messages and this is a table",
    "spin.csv spin.csv --topic x": "... did you mean '--topic-a' or '--topic-b'?",
    "spin.csv spin.csv -t x": "No such option '-t'; did you mean '--topic-a' or '--topic-b'?",
    "spin.csv spin.csv --quat-cols 1,2,3,4": "... did you mean '--quat-cols-a' or '--quat-cols-b'?",
    "spin.csv spin.csv --quat-col-b x": "... did you mean '--quat-cols-a' or '--quat-cols-b'?",
    "spin.csv spin.csv --algin mean": "No such option '--algin'; did you mean '--align'?",
    "q.csv zeros.csv": "1 of 3 rows are invalid quaternions (1 all zero), the first is row 2",
    "q.csv plain.csv": "no attitudes found; ... the columns with --quat-cols-b, --from-layout-b "
    "and --time-col-b",
    "two.mcap q.csv": f"{TWO_TOPICS} --topic-a",
    "q.csv two.mcap": f"{TWO_TOPICS} --topic-b",
    "gyros.bag q.csv --topic-a /imu_raw --topic-a=/b": f"--topic-a {ONE_TOPIC}",
    "spin.csv spin.csv --judge +5s..+6s": "no pair of attitudes is in the time ranges of --judge",
    "gyros.bag:/cam/imu q.csv --topic-a /imu_raw": f"Error: gyros.bag:/cam/imu: {TOPICS}",
    # It is empty when it has been read: the log would not be to blame.
    "- -": ONCE,
}

JPL = "--from-convention says hamilton, but the metadata of the file says jpl; omit it"
OF_MATRIX = "does not apply to matrix; omit it"
NO_MESSAGES = "csv holds no messages; omit --message, --out-topic and --frames"
ROTATIONS = (
    "is not a rotation; write three signed axes such as x,-y,-z, a quaternion W,X,Y,Z that takes "
    "old axes to new ones, fixed-axis angles in deg such as rpy:0,30,0 or y:30deg, "
    "ned-to-enu, enu-to-ned, frd-to-flu, flu-to-frd"
)
CONVERT = {
    "q.csv a.csv b.csv c.csv": "unexpected argument 'b.csv'; convert takes IN OUT: run it once",
    "q.csv - --left x,y,-z": "the rotation 'x,y,-z' is left-handed",
    "q.csv - --left 2,0,0,0": "the rotation '2,0,0,0' has the length 2",
    **{
        f"q.csv - --left {text}": f"'{text}' {ROTATIONS}"
        for text in (
            "ned",
            "rpy:1,2",
            "rpy:x,-y,-z",
            "rpy:1,2,3,4",
            "y:",
            "y:30rad",
            "1,2,3",
            "nan,0,0,1",
            "rpy:inf,0,0",
        )
    },
    "q.csv - --as body-rates --layout wxyz": "--layout does not apply to body-rates; omit it",
    "q.csv - --as body-rates --direction ref-to-body": "--direction does not apply to body-rates",
    "q0.csv out.csv --report q0.csv": f"Error: q0.csv: {INPUT}",
    "q.csv q.csv": f"Error: q.csv: {INPUT}",
    "q.csv link.csv": f"Error: link.csv: {INPUT}",
    "swapped.parquet out.csv": "the metadata say scalar-first, but the columns 'qx', 'qy', 'qz', "
    "'qw' are scalar-last by name; settle it with --from-layout scalar-last",
    "jpl.parquet out.csv --from-convention hamilton": JPL,
    "damaged.parquet -": "its metadata 'quatprop' is not the JSON it should be",
    "zeros.csv old.csv": "1 of 3 rows are invalid quaternions (1 all zero), the first is row 2 at ",
    "absent.csv out.csv": "none of 2 rows holds an attitude (they are absent, not finite or no "
    "rotations); if the log holds body rates, propagate them first",
    "header.csv out.csv": "no samples in 'qw,qx,qy,qz'",
    "q.csv out.tum --convention jpl": "kind 'tum' holds Hamilton quaternions body to reference "
    "by its",
    "q.csv out.tum --as matrix": "kind 'tum' holds quaternions only",
    "q.csv - --as matrix --layout wxyz": f"--layout {OF_MATRIX}",
    "q.csv - --as matrix --convention jpl": f"--convention {OF_MATRIX}",
    "q.csv - --as matrix --sign positive": f"--sign {OF_MATRIX}",
    "q.csv - --as matrix --message TFMessage": f"--message {OF_MATRIX}",
    "q.csv - --as matrix --euler-unit deg": "--euler-unit requires euler-zyx or another",
    "q.csv - --as euler": "'euler' is not one of 'quaternion', ... did you mean 'euler-zyx'?",
    "gyros.bag:/cam/imu out.csv -t /imu_raw": f"Error: gyros.bag:/cam/imu: {TOPICS}",
    "q.csv out.csv --start +1h": "no samples in 'qw,qx,qy,qz' between --start and --end: 2 are "
    "before, 0 after; the log",
    # A position was offered as the time.
    "a.kitti -": "the time column is not declared; specify it with --time-col C, or --sample-rate "
    "HZ for rows at a steady rate",
    "b.kitti -": "it has 4 columns, and a KITTI trajectory has 12: r11 r12 r13 tx",
    **{
        f"q.csv out --to {kind} --message PoseInFrame": "'PoseInFrame' is Foxglove's own, in "
        "protobuf, and ROS bags hold ROS messages; write mcap, or choose 'QuaternionStamped', "
        for kind in ("bag", "rosbag2", "rosbag2-mcap")
    },
    "q.csv out.csv --message TFMessage": NO_MESSAGES,
    "q.csv out.csv --message TFMessage --convention jpl": NO_MESSAGES,
    "q.csv a.tum --with euler-zyx": "--with: tum has its own columns; choose 'csv', ",
    "q.csv a.mcap --with euler-zyx": "--with: mcap has its own columns; choose 'csv', ",
    "q.csv - --with euler-zyx --as rotvec": "--with does not apply to rotvec; omit it",
    "q.csv - --with euler-zyx --direction ref-to-body": "--with requires Hamilton quaternions bo",
    "q.csv - --with rotvec --euler-unit deg": "--euler-unit requires euler-zyx or another sequen",
}

SMALL = "the panels and their letters do not fit into this picture; give at least --size "
SIZE = "is not a size from 1in to 100in; write 90mm or 16x9cm"
PLOT = {
    "q.csv -o a.jpg": "Error: a.jpg: the suffix is not an image format; use .png, .svg or .pdf, "
    "or .html for a report",
    "q.csv -o -": "Error: -: a plot is written to a file; name one that ends in .png",
    "q.svg --from csv -o q.svg": f"Error: q.svg: {INPUT}",
    "q.csv --reference q.svg -o q.svg": f"Error: q.svg: {INPUT}",
    "q.csv none.csv -o old.png": "none.csv: no such file",
    "q.csv --components --unwrap": "--unwrap cannot be combined with --components",
    "q.csv --tol 1deg": "Error: --tol requires --reference",
    "q.csv --topic-ref /a": "Error: --topic-ref requires --reference",
    "q.csv --reference q.csv --components": "--components cannot be combined with --reference",
    "both.csv --components --show rates": "Error: --components requires --show attitude",
    "q.csv --start +1h": "no samples in 'qw,qx,qy,qz' between --start and --end: 2 are before, 0 ",
    "log.csv q.csv": "Error: log.csv shows rate x in rad/s and q.csv yaw in deg; draw them apart,",
    "height.parquet": "no body rates or attitudes found; its columns are 't_ns', 'height'; name "
    "the columns with --rate-cols or --quat-cols and --time-col",
    "angles.csv": "the unit of the angles 'yaw', 'pitch', 'roll' is not declared; specify it with",
    "q.csv --reference two.mcap": f"{TWO_TOPICS} --topic-ref",
    "two.mcap --reference q.csv": f"{TWO_TOPICS} --topic",
    "gyros.bag:/cam/imu -t /imu_raw": f"Error: gyros.bag:/cam/imu: {TOPICS}",
    "- -": ONCE,
    "- --reference -": ONCE,
    **{
        f"q.csv --size={size}": f"'{size}' {SIZE}"
        for size in ("5", "0.5in", "3inx4in", "1e9mm", "10x", "-3in", "3x0in")
    },
    "q.csv --size 1in": SMALL,
}

INFO = {
    "gyros.bag:/cam/imu -t /imu_raw": f"Error: gyros.bag:/cam/imu: {TOPICS}",
    "empty.mcap": "Error: empty.mcap: the file is empty; was the recording closed?",
    "folder.csv --from bag": f"Error: folder.csv: a folder is not a log of kind bag; {KIND}",
    "log.csv --from rosbag2": f"Error: log.csv: a file is not a log of kind rosbag2; {KIND}",
    "escapes.parquet": "no body rates or attitudes found; its columns are 't_ns', '\\x1b[31mred",
    "--frame x": "Error: No such option '--frame'",
    "both.csv --rate-cols a,b,c": "--rate-cols asks for column 'a'",
    "q.csv --as-config": "it does not say with which options it was made; outputs of",
    "q.csv q.csv --as-config": "--as-config prints one file for one LOG",
}

OTHERS = {
    "propagate gyros.bag:/imu_raw": GO,
    "propagate log.csv out.csv": "name the output: -o out.csv",
    "propagate log.csv old.csv": GO,
    "propagat": "Error: No such command 'propagat'; did you mean 'propagate'?",
    "simulate a.csv b.csv": "unexpected argument 'b.csv'; simulate takes OUT: run it once for each",
    # It was called a bug of this program.
    "calibrate no_rates.csv spin.csv": "Error: no_rates.csv: no samples in 'wx,wy,wz'; look with",
    "draw": "Error: No such command 'draw'; quatprop --help lists the commands",
}

OUTPUT = {"propagate": "out.csv", "plot": "a.png"}
COMMANDS = {
    "propagate": PROPAGATE, "batch": BATCH, "simulate": SIMULATE, "compare": COMPARE,
    "convert": CONVERT, "plot": PLOT, "info": INFO,
}  # fmt: skip


def command_lines():
    """Yield every command line with its sentence; an output that is not named is a usual one."""
    yield from OTHERS.items()
    for command, lines in COMMANDS.items():
        for line, sentence in lines.items():
            is_named = command not in OUTPUT or " -o" in line
            output = "" if is_named else f" -o {OUTPUT[command]}"
            yield f"{command} {line}{output}", sentence


@pytest.fixture(scope="session")
def small_files(tmp_path_factory):
    """Write the files that the command lines name."""
    return write_small_files(tmp_path_factory.mktemp("small"))


def contents(folder):
    """Return every path below a folder, with the bytes of files."""
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob("*")}


@pytest.mark.parametrize(("line", "sentence"), list(command_lines()))
def test_it_is_one_sentence_and_nothing_is_written(small_files, monkeypatch, line, sentence):
    """The sentence names the option or the file, and the remedy."""
    monkeypatch.chdir(small_files)
    before = contents(small_files)
    said = refused(*shlex.split(line), input=ATTITUDES)
    assert said.startswith("Error: ")
    assert begins(said, sentence), said
    assert contents(small_files) == before
