"""MCAP files of springtwin under foreign readers, and a bag of a foreign writer under springtwin.

Usage: check.py PROGRAM FOLDER

Every value is compared with the table that `springtwin convert F.rrd F.csv` writes: numbers as the text of the table, angles and
poses of motion capture to the last digit that the table has.
"""

import csv
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
SPRINGS = [f"{pair}{half}" for pair in range(1, 7) for half in "AB"]
KPA, MM, DEG = 1e3, 1e-3, math.pi / 180
PAIR_S = 0.1
LAST_DIGIT = 1.01e-6
STORE = get_typestore(Stores.ROS2_HUMBLE)


def run(program, *args):
    """The program's JSON."""
    command = [program, *map(str, args), "--json", "--overwrite"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}: {done.stderr}")
    return json.loads(done.stdout)


def table(path):
    """Rows of a table, as text."""
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def stamp_ns(message, log_ns):
    header = getattr(message, "header", None)
    return log_ns if header is None else header.stamp.sec * 10**9 + header.stamp.nanosec


def by_mcap(path):
    """Messages by topic and stamp, by `mcap` and `mcap-ros2-support`; and the metadata."""
    topics = {}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        for _, channel, message, decoded in reader.iter_decoded_messages():
            of = topics.setdefault(channel.topic, [])
            of.append((stamp_ns(decoded, message.log_time), decoded))
            if channel.topic != "/tf":
                assert stamp_ns(decoded, message.log_time) == message.log_time
        summary = reader.get_summary()
        counts = summary.statistics.channel_message_counts
        for number, channel in summary.channels.items():
            assert counts[number] == len(topics[channel.topic]), channel.topic
    return topics, metadata


def by_rosbags(path):
    """The same by `rosbags`, which holds our definitions against those of ROS 2."""
    topics = {}
    with Reader(path) as reader:
        for connection in reader.connections:
            types = get_types_from_msg(connection.msgdef.data, connection.msgtype)
            for name, fields in types.items():
                assert fields[1] == STORE.fielddefs[name][1], name
        for connection, log_ns, raw in reader.messages():
            message = STORE.deserialize_cdr(raw, connection.msgtype)
            topics.setdefault(connection.topic, []).append((stamp_ns(message, log_ns), message))
    return topics


def ypr_deg(q):
    """Yaw, pitch and roll of R = Rz Ry Rx."""
    x, y, z, w = q
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - x * z))))
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return [yaw / DEG, pitch / DEG, roll / DEG]


def quaternion(of):
    return np.array([of.x, of.y, of.z, of.w])


def pose_at(poses, ns):
    """Between the two poses around a time, as a session has it; None where there are none."""
    stamps, places, turns = poses
    after = int(np.searchsorted(stamps, ns))
    if after == len(stamps):
        return None
    if stamps[after] == ns:
        return places[after], turns[after]
    if after == 0:
        return None
    apart_ns = stamps[after] - stamps[after - 1]
    if apart_ns * 1e-9 > PAIR_S:
        return None
    share = (ns - stamps[after - 1]) / apart_ns
    a, b = turns[after - 1], turns[after]
    b = b if a @ b >= 0 else -b
    angle = math.acos(min(1.0, a @ b))
    if angle < 1e-12:
        turn = a
    else:
        turn = (math.sin((1 - share) * angle) * a + math.sin(share * angle) * b) / math.sin(angle)
    place = places[after - 1] + share * (places[after] - places[after - 1])
    return place, turn / np.linalg.norm(turn)


class Compared:
    """Counts what was compared."""

    def __init__(self):
        self.equal = self.gaps = self.near = 0

    def text(self, cell, value, where):
        if value is None:
            assert cell == "", (where, cell)
            self.gaps += 1
            return
        assert cell == f"{value:.6f}", (where, cell, value)
        self.equal += 1

    def digit(self, cell, value, where):
        if value is None:
            assert cell == "", (where, cell)
            self.gaps += 1
            return
        off = abs(float(cell) - value)
        assert min(off, abs(off - 360)) <= LAST_DIGIT, (where, cell, value)
        self.near += 1


def compare(topics, rows, name):
    """Holds the messages of a reader against the rows of the table."""
    compared = Compared()
    payload = topics["/payload"]
    assert len(payload) == len(rows), (len(payload), len(rows))
    at = {topic: dict(messages) for topic, messages in topics.items()}
    mocap = topics.get("/mocap/pose") or topics.get("/simulated_mocap/pose") or []
    poses = (
        np.array([ns for ns, _ in mocap], dtype=np.int64),
        [np.array([m.pose.position.x, m.pose.position.y, m.pose.position.z]) for _, m in mocap],
        [quaternion(m.pose.orientation) for _, m in mocap],
    )
    for row, (ns, message) in zip(rows, payload):
        assert row["t_s"] == f"{ns // 10**9}.{ns % 10**9:09d}", (row["t_s"], ns)
        springs = at["/springs"].get(ns)
        lengths = dict(zip(springs.name, springs.position)) if springs else {}
        if springs:
            assert len(springs.velocity) == 0 and len(springs.effort) == 0
        for i, spring in enumerate(SPRINGS):
            length = lengths.get(spring)
            mm = None if length is None else length / MM
            compared.text(row[f"spring{i + 1}_mm"], mm, (name, ns, spring))
        for i in range(1, 7):
            for topic, column in [("gauge_pressure", f"p{i}_kpa"), ("set_gauge_pressure", f"u{i}_kpa")]:
                if column in row:
                    found = at.get(f"/chamber{i}/{topic}", {}).get(ns)
                    kpa = None if found is None else found.fluid_pressure / KPA
                    compared.text(row[column], kpa, (name, ns, column))
        for i in range(1, 5):
            found = at.get(f"/imu{i}/data", {}).get(ns)
            angles = [None] * 3 if found is None else ypr_deg(quaternion(found.orientation))
            if found is not None:
                assert found.angular_velocity_covariance[0] == -1
                assert found.linear_acceleration_covariance[0] == -1
            for angle, value in zip(["yaw", "pitch", "roll"], angles):
                compared.digit(row[f"imu{i}_{angle}_deg"], value, (name, ns, i, angle))
        pose = pose_at(poses, ns) if mocap else None
        values = [None] * 6 if pose is None else [*(pose[0] / MM), *ypr_deg(pose[1])]
        columns = ["x_mm", "y_mm", "z_mm", "yaw_deg", "pitch_deg", "roll_deg"]
        for column, value in zip(columns, values):
            compared.digit(row[f"vicon_{column}"], value, (name, ns, column))
        if "payload_kg" in row:
            compared.text(row["payload_kg"], message.data, (name, ns, "payload"))
        if message.data > 0:
            weight = at["/load"][ns].wrench.force.z
            assert abs(weight + message.data * 9.80665) < 1e-12, weight
    for i in range(1, 5):
        for _, raw in topics.get(f"/imu{i}/data_raw", []):
            assert raw.orientation_covariance[0] == -1
            length = np.linalg.norm([raw.linear_acceleration.x, raw.linear_acceleration.y, raw.linear_acceleration.z])
            assert 5 < length < 15, length
    print(
        f"{name}: {len(rows)} rows, {compared.equal} values equal as text, {compared.near} equal to the last digit, "
        f"{compared.gaps} gaps in both"
    )


def tables_agree(one, other, name):
    """Two tables of sessions: equal text, angles to the last digit."""
    a, b = table(one), table(other)
    assert len(a) == len(b), (len(a), len(b))
    differ = 0
    for x, y in zip(a, b):
        assert x.keys() == y.keys(), x.keys() ^ y.keys()
        for key in x:
            if x[key] != y[key]:
                is_turn = key.endswith("_deg")
                assert is_turn and abs(float(x[key]) - float(y[key])) <= LAST_DIGIT, (name, key, x[key], y[key])
                differ += 1
    print(f"{name}: {len(a)} rows come back, {differ} angles differ in the last digit")


def out_and_back(program, folder):
    for recording in sorted((ROOT / "recordings").glob("*.rrd")):
        name = recording.stem
        bag, text, session = folder / f"{name}.mcap", folder / f"{name}.csv", folder / f"{name}-back"
        run(program, "convert", recording, bag)
        run(program, "convert", recording, text)
        rows = table(text)
        topics, metadata = by_mcap(bag)
        about = metadata["springtwin"]
        assert about["simulated"] == "true" and len(about["robot_hash"]) == 64, about
        assert about["name"] == name and about["source"] == "virtual rig", about
        assert "/simulated_mocap/pose" in topics and "/mocap/pose" not in topics
        assert {"/estimate/pose", "/tf", "/diagnostics", "/imu4/data_raw"} <= topics.keys(), topics.keys()
        compare(topics, rows, f"{name} by mcap")
        other = by_rosbags(bag)
        assert {t: len(m) for t, m in other.items()} == {t: len(m) for t, m in topics.items()}
        compare(other, rows, f"{name} by rosbags")
        report = run(program, "import", bag, "--out", session)
        assert report["simulated"] is True and report["samples"] == len(rows), report
        tables_agree(text, session / "log.csv", name)
        again, back = folder / f"{name}-session.mcap", folder / f"{name}-again"
        run(program, "convert", session, again)
        run(program, "import", again, "--out", back)
        tables_agree(session / "log.csv", back / "log.csv", f"{name} as a session")


def message(kind, **values):
    return STORE.types[kind](**values)


def write_lab(rows, path):
    """A bag as another lab has it: other names, absolute pressures, wall clock, a gap, commands when they change."""
    if path.exists():
        for file in path.iterdir():
            file.unlink()
        path.rmdir()
    begin_ns = 1_760_000_000_123_456_789
    first_ns = round(float(rows[0]["t_s"]) * 1e9)
    time_of, header_of = STORE.types["builtin_interfaces/msg/Time"], STORE.types["std_msgs/msg/Header"]
    vector, turn_of = STORE.types["geometry_msgs/msg/Vector3"], STORE.types["geometry_msgs/msg/Quaternion"]

    def header(ns, frame=""):
        return header_of(stamp=time_of(sec=ns // 10**9, nanosec=ns % 10**9), frame_id=frame)

    def turn(row, columns):
        yaw, pitch, roll = (float(row[c]) * DEG / 2 for c in columns)
        cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (math.cos, math.sin))
        return turn_of(
            x=cy * cp * sr - sy * sp * cr, y=cy * sp * cr + sy * cp * sr, z=sy * cp * cr - cy * sp * sr,
            w=cy * cp * cr + sy * sp * sr,
        )

    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer as bag:
        channels = {}

        def put(topic, kind, log_ns, of):
            if topic not in channels:
                channels[topic] = bag.add_connection(topic, kind, typestore=STORE)
            bag.write(channels[topic], log_ns, STORE.serialize_cdr(of, kind))

        kept, last_set = [], None
        for k, row in enumerate(rows):
            ns = begin_ns + round(float(row["t_s"]) * 1e9) - first_ns
            log_ns = ns + 3_000_000
            columns = [f"u{i}_kpa" for i in range(1, 7)]
            now = [float(row.get(c) or "nan") for c in columns]
            if now != last_set and not any(map(math.isnan, now)):
                kind = "std_msgs/msg/Float64MultiArray"
                layout = message("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
                # Without a header: the bag's time counts, and the row is not later than it.
                put("/lab/set", kind, ns - 100_000, message(kind, layout=layout, data=np.array(now)))
                last_set = now
            if 400 <= k < 450:
                continue
            kept.append((k, now if last_set is None else last_set))
            lengths = [(f"s{i}", float(row[f"spring{i}_mm"]) * MM) for i in range(12, 0, -1) if row[f"spring{i}_mm"]]
            kind = "sensor_msgs/msg/JointState"
            empty = np.array([], dtype=np.float64)
            put("/lab/lengths", kind, log_ns, message(
                kind, header=header(ns), name=[n for n, _ in lengths], position=np.array([m for _, m in lengths]),
                velocity=empty, effort=empty,
            ))
            kind = "sensor_msgs/msg/FluidPressure"
            for i in range(1, 7):
                if row[f"p{i}_kpa"]:
                    pa = float(row[f"p{i}_kpa"]) * KPA + 101325.0
                    put(f"/lab/gauge{i}", kind, log_ns, message(
                        kind, header=header(ns + 1_000_000), fluid_pressure=pa, variance=0.0))
            kind = "sensor_msgs/msg/Imu"
            for i in range(1, 5):
                angles = [f"imu{i}_{a}_deg" for a in ("yaw", "pitch", "roll")]
                if k % 2 == 0 and all(row[a] for a in angles):
                    zero, none = vector(x=0.0, y=0.0, z=0.0), np.zeros(9)
                    # Every tenth one is marked as without an orientation.
                    marked = none.copy()
                    marked[0] = -1.0 if k % 20 == 0 else 0.0
                    put(f"/lab/imu{i}", kind, log_ns, message(
                        kind, header=header(ns), orientation=turn(row, angles), orientation_covariance=marked,
                        angular_velocity=zero, angular_velocity_covariance=none, linear_acceleration=zero,
                        linear_acceleration_covariance=none))
            if row["vicon_x_mm"]:
                place = [float(row[f"vicon_{a}_mm"]) * MM for a in "xyz"]
                angles = [f"vicon_{a}_deg" for a in ("yaw", "pitch", "roll")]
                stamped = "geometry_msgs/msg/TransformStamped"
                transform = message("geometry_msgs/msg/Transform", translation=vector(*place), rotation=turn(row, angles))
                other = message("geometry_msgs/msg/Transform", translation=vector(1.0, 2.0, 3.0), rotation=turn(row, angles))
                put("/tf", "tf2_msgs/msg/TFMessage", log_ns, message("tf2_msgs/msg/TFMessage", transforms=[
                    message(stamped, header=header(ns), child_frame_id="cart", transform=other),
                    message(stamped, header=header(ns), child_frame_id="end_pad", transform=transform),
                ]))
    return kept


def of_another_lab(program, folder):
    recorded = folder / "rig"
    run(program, "rig", "session", "--seconds", 25, "--out", recorded)
    rows = table(recorded / "log.csv")
    kept = write_lab(rows, folder / "lab")
    [bag] = (folder / "lab").glob("*.mcap")
    session = folder / "lab-session"
    report = run(program, "import", "log", HERE / "lab.toml", bag, "--out", session)
    read = table(session / "log.csv")
    assert len(read) == len(kept) == report["samples"], (len(read), len(kept), report)
    assert report["notes"][0].startswith("0 s is the first row, 1760000000.123456789 s"), report["notes"]
    assert any("longest gap between rows is 1.02 s" in note for note in report["notes"]), report["notes"]
    assert any(note.startswith("times of /lab/set: when the bag") for note in report["notes"]), report["notes"]
    first_s, values = float(rows[0]["t_s"]), 0

    def near(one, other, where, most):
        off = abs(float(one) - float(other))
        assert min(off, abs(off - 360)) <= most, (where, one, other)

    for got, (k, now) in zip(read, kept):
        row = rows[k]
        near(got["t_s"], float(row["t_s"]) - first_s, k, 1e-9)
        for i, kpa in enumerate(now):
            column = f"u{i + 1}_kpa"
            if math.isnan(kpa):
                assert not got.get(column), (k, column)
            else:
                near(got[column], kpa, (k, column), 2e-6)
                values += 1
        for column, text in row.items():
            if column.startswith(("t_s", "u", "payload")):
                continue
            # Every other row has IMUs, and every tenth of these has no orientation.
            if column.startswith("imu") and (k % 2 == 1 or k % 20 == 0):
                text = ""
            if text == "":
                assert got[column] == "", (k, column, got[column])
            else:
                near(got[column], text, (k, column), 2e-6)
                values += 1
    print(f"a bag of rosbags: {len(read)} rows, {values} values are those that were written")
    refused = subprocess.run(
        [program, "import", bag, "--out", folder / "none"], capture_output=True, text=True
    )
    assert refused.returncode != 0 and "import log MAP.toml" in refused.stderr, refused
    assert len(refused.stderr.strip().splitlines()) == 1, refused.stderr
    finding = run(program, "gap", "run", "--session", session, "--out", folder / "finding")
    print(f"gap run takes it: verdict {finding['verdict']}")


if __name__ == "__main__":
    program, folder = str(Path(sys.argv[1]).resolve()), Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    out_and_back(program, folder)
    of_another_lab(program, folder)
