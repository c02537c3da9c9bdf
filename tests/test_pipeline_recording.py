"""Recording nodes: what is said on topics, as CSV, bags and in a database; live and from bags."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import urllib.parse
import urllib.request
from http.server import BaseHTTPRequestHandler, HTTPServer
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from free_ports import free_port

from fame.cli import main
from fame.clock import SECOND, Scheduler
from fame.errors import ConfigError
from fame.middleware import messages
from fame.middleware.local import LocalMiddleware
from fame.monitor import data_files
from fame.monitor.data_files import read_runs
from fame.monitor.pipeline.configuration import Configuration, load
from fame.monitor.pipeline.recording import RecordingNode, RecordingOptions, play, record_bag
from fame.monitor.pipeline.sinks import BagWriter, Influx, Row

JOINT_STATE = "sensor_msgs/msg/JointState"
EFFORTS = {"Topic": "joint_states", "Field": ["effort"], "MessageType": JOINT_STATE}
ELBOW = {"Topic": "joint_states", "Field": ["position", "elbow"], "MessageType": JOINT_STATE}
FORCE = {"Topic": "force", "Field": ["data"], "MessageType": "std_msgs/msg/Float64"}


def configuration(folder: Path, **inputs: Any) -> Configuration:
    path = folder / "joints.yaml"
    path.write_text(yaml.safe_dump({"Inputs": inputs or {"Efforts": EFFORTS, "Elbow": ELBOW}}, sort_keys=False))
    return load(path)


class Bench:
    """Topics on simulated time."""

    def __init__(self) -> None:
        self.scheduler = Scheduler()
        self.middleware = LocalMiddleware(self.scheduler)
        outside = self.middleware.node("arm")
        self.arm = outside.publisher("joint_states", JOINT_STATE)
        self.force = outside.publisher("force", "std_msgs/msg/Float64")
        self.begin = outside.publisher("task_start", "std_msgs/msg/Empty")
        self.said: list[str] = []

    def record(self, of: Configuration, *outputs: Path | str, **options: Any) -> RecordingNode:
        made = RecordingOptions(report=self.said.append, **options)
        return RecordingNode(self.middleware, self.scheduler, of, outputs, made)

    def joints(self, stamp: float, *efforts: float) -> None:
        content = {"header": {"stamp": stamp}, "name": ["elbow", "wrist"], "effort": list(efforts)}
        self.arm.publish(messages.create(JOINT_STATE, {**content, "position": [10 * stamp, 0.0]}))

    def run(self, seconds: float = 0.01) -> None:
        self.scheduler.run(self.scheduler.now + round(seconds * SECOND))


def test_each_message_is_a_row_with_its_stamp_and_columns_named_by_channel(tmp_path: Path) -> None:
    bench = Bench()
    node = bench.record(configuration(tmp_path), tmp_path / "runs.csv")
    bench.joints(0.1, 1.0, 2.5)
    bench.joints(0.2, -1.0, 1e-7)
    bench.run()
    node.close()
    assert (tmp_path / "runs.csv").read_text() == (
        "stamp,run,Efforts.elbow,Efforts.wrist,Elbow\n0.100000000,0,1,2.5,1\n0.200000000,0,-1,1e-07,2\n"
    )
    (run,) = read_runs([tmp_path / "runs.csv"], ["Elbow", "Efforts.wrist"])
    assert run.values.tolist() == [[1.0, 2.5], [2.0, 1e-7]]


def test_cells_of_a_topic_that_said_nothing_are_empty(tmp_path: Path) -> None:
    bench = Bench()
    node = bench.record(configuration(tmp_path, Force=FORCE, Efforts=EFFORTS), tmp_path / "runs.csv")
    bench.joints(0.1, 1.0, 2.0)
    bench.run(0.25)
    bench.force.publish(messages.create("std_msgs/msg/Float64", 7))
    bench.run()
    node.close()
    assert (tmp_path / "runs.csv").read_text().splitlines() == [
        "stamp,run,Force,Efforts.elbow,Efforts.wrist", "0.100000000,0,,1,2", "0.250000000,0,7,,",
    ]  # fmt: skip


@pytest.mark.parametrize("output", ["runs.csv", "runs.mcap", "runs"])
def test_what_heard_nothing_leaves_nothing_behind(tmp_path: Path, output: str) -> None:
    bench, of = Bench(), configuration(tmp_path)
    for _ in range(2):
        bench.record(of, tmp_path / output).close()
        assert [path.name for path in tmp_path.iterdir()] == ["joints.yaml"]


def test_an_empty_file_is_no_recording(tmp_path: Path) -> None:
    (tmp_path / "runs.csv").touch()  # of a process that was killed
    bench = Bench()
    node = bench.record(configuration(tmp_path), tmp_path / "runs.csv")
    bench.joints(0.1, 1.0, 2.0)
    bench.run()
    node.close()
    assert (tmp_path / "runs.csv").read_text().startswith("stamp,run")


def test_a_topic_that_stays_silent_has_no_columns_and_that_is_said(tmp_path: Path) -> None:
    bench = Bench()
    node = bench.record(configuration(tmp_path, Force=FORCE, Efforts=EFFORTS), tmp_path / "runs.csv")
    for second in range(1, 13):
        bench.joints(float(second), 1.0, 2.0)
        bench.run(1.0)
    bench.force.publish(messages.create("std_msgs/msg/Float64", 7))
    bench.run()
    node.close()
    lines = (tmp_path / "runs.csv").read_text().splitlines()
    assert (lines[0], len(lines)) == ("stamp,run,Efforts.elbow,Efforts.wrist", 13)
    assert "joints: force: silent for 10 s; it has no columns" in bench.said
    assert "joints: force: left out: 1 values for 0 columns" in bench.said


def test_runs_are_told_apart_by_a_topic_and_a_file_goes_on_with_the_next(tmp_path: Path) -> None:
    bench = Bench()
    for _ in range(2):
        node = bench.record(configuration(tmp_path), tmp_path / "a.csv", append=True, run_topic="/task_start")
        for stamp in (0.1, 0.2):
            bench.begin.publish(messages.create("std_msgs/msg/Empty"))
            bench.run()
            bench.joints(stamp, 1.0, 2.0)
            bench.run()
        bench.begin.publish(messages.create("std_msgs/msg/Empty"))
        bench.run()
        node.close()
        assert node.recorded_runs == 2, "one that has no rows yet does not count"
    assert [line.split(",")[1] for line in (tmp_path / "a.csv").read_text().splitlines()] == ["run", *"0123"]
    with pytest.raises(ConfigError, match="exists already; use --append to continue it"):
        bench.record(configuration(tmp_path), tmp_path / "a.csv")
    node = bench.record(configuration(tmp_path, Efforts=EFFORTS), tmp_path / "a.csv", append=True)
    bench.joints(0.1, 1.0, 2.0)
    with pytest.raises(ConfigError, match=r"has the columns stamp,run,Efforts\.elbow,Efforts\.wrist,Elbow; now"):
        bench.run()


def test_a_torn_last_line_is_cut_off_when_a_file_goes_on_and_left_out_when_it_is_read(tmp_path: Path) -> None:
    bench = Bench()
    (tmp_path / "a.csv").write_text("stamp,run,Efforts.elbow,Efforts.wrist,Elbow\n0.1,0,1,2,3\n0.2,0,1,2,3")
    assert len(read_runs([tmp_path / "a.csv"])[0]) == 1
    node = bench.record(configuration(tmp_path), tmp_path / "a.csv", append=True)
    bench.joints(0.3, 1.0, 2.0)
    bench.run()
    node.close()
    assert (tmp_path / "a.csv").read_text().splitlines()[1:] == ["0.1,0,1,2,3", "0.300000000,1,1,2,3"]


def test_what_cannot_be_used_is_left_out_and_said(tmp_path: Path) -> None:
    bench = Bench()
    node = bench.record(configuration(tmp_path), tmp_path / "a.csv")
    bench.joints(0.1, 1.0, 2.0)
    bench.joints(0.2, float("nan"), 2.0)
    bench.joints(0.05, 1.0, 2.0)
    bench.joints(0.3, 1.0)
    bench.run()
    node.close()
    assert node.rows == 1
    assert [text.partition("left out: ")[2] for text in bench.said] == [
        "Efforts is not finite", "a sample 0.05 s older of stamp 0.050 s after 0.100 s",
        "Efforts has (1,) values, before it had (2,)",
    ]  # fmt: skip


def test_joints_in_another_order_go_to_their_columns(tmp_path: Path) -> None:
    bench = Bench()
    node = bench.record(configuration(tmp_path), tmp_path / "a.csv")
    for number, names in enumerate(("elbow wrist", "wrist elbow", "wrist elbow", "elbow wrist"), start=1):
        content = {"header": {"stamp": number / 10}, "name": names.split(), "position": [0.0, 0.0]}
        efforts = [{"elbow": 1.0, "wrist": 2.0}[name] for name in names.split()]
        bench.arm.publish(messages.create(JOINT_STATE, {**content, "effort": efforts}))
    bench.run()
    node.close()
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0] == "stamp,run,Efforts.elbow,Efforts.wrist,Elbow"
    assert [line.split(",")[2:] for line in lines[1:]] == [["1", "2", "0"]] * 4
    assert bench.said == []


def test_another_device_on_a_topic_does_not_get_into_the_columns_of_the_first(tmp_path: Path) -> None:
    bench = Bench()
    node = bench.record(configuration(tmp_path, Efforts=EFFORTS), tmp_path / "a.csv")
    for number, names in enumerate((["elbow", "wrist"], ["left", "right"], [], ["elbow", "wrist"]), start=1):
        content = {"header": {"stamp": number / 10}, "name": names, "effort": [float(number), 0.0]}
        bench.arm.publish(messages.create(JOINT_STATE, content))
    bench.run()
    node.close()
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert [line.split(",")[2] for line in lines[1:]] == ["1", "4"]
    assert [text.partition("left out: ")[2] for text in bench.said] == [
        "Efforts has the channels left, right, before it had the channels elbow, wrist",
        "Efforts has no names, before it had the channels elbow, wrist",
    ]


@pytest.mark.parametrize("output", ["runs.txt", "runs.db3"])
def test_another_ending_is_refused(tmp_path: Path, output: str) -> None:
    with pytest.raises(ConfigError, match=r"expected \.csv, \.mcap, no ending \(a bag\) or http://"):
        Bench().record(configuration(tmp_path), tmp_path / output)


# ---- bags ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("output", ["runs", "runs.mcap"])
def test_a_bag_that_was_recorded_gives_the_same_rows_as_the_topics(tmp_path: Path, output: str) -> None:
    bench = Bench()
    of = configuration(tmp_path)
    node = bench.record(of, tmp_path / "live.csv", tmp_path / output)
    for number in range(1, 30):
        bench.joints(number / 10, float(number), 0.5)
        bench.run()
    node.close()
    record_bag(tmp_path / output, of, [tmp_path / "bag.csv"])
    assert (tmp_path / "bag.csv").read_text() == (tmp_path / "live.csv").read_text()


def ros1_bag(path: Path) -> None:
    """A bag of ROS 1."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    with Writer(path) as bag:
        connection = bag.add_connection("/joint_states", JOINT_STATE, typestore=store)
        for number in range(3):
            header = types["std_msgs/msg/Header"](number, types["builtin_interfaces/msg/Time"](5, number), "")
            message = types[JOINT_STATE](
                header, ["elbow", "wrist"], np.array([1.0, 2.0]), np.zeros(0), np.array([number, 0.0])
            )
            bag.write(connection, 5_000_000_000 + number, store.serialize_ros1(message, JOINT_STATE))


def test_a_bag_of_ros_1_is_read(tmp_path: Path) -> None:
    ros1_bag(tmp_path / "old.bag")
    node = record_bag(tmp_path / "old.bag", configuration(tmp_path), [tmp_path / "old.csv"])
    assert node.rows == 3
    assert (tmp_path / "old.csv").read_text().splitlines()[-1] == "5.000000002,0,2,0,1"


def test_a_bag_without_the_topic_or_with_another_type_is_refused_before_a_file_is_made(tmp_path: Path) -> None:
    ros1_bag(tmp_path / "old.bag")
    for inputs, reason in (
        ({"Force": FORCE}, "has no topic /force; it has /joint_states"),
        ({"X": {**FORCE, "Topic": "joint_states"}}, "expected std_msgs/msg/Float64 on /joint_states, got sensor_msgs"),
    ):
        with pytest.raises(ConfigError, match=reason):
            record_bag(tmp_path / "old.bag", configuration(tmp_path, **inputs), [tmp_path / "x.csv"])
    with pytest.raises(ConfigError, match="is not a readable bag"):
        record_bag(tmp_path / "none.bag", configuration(tmp_path), [tmp_path / "x.csv"])
    assert not (tmp_path / "x.csv").exists()


def test_of_a_bag_that_is_damaged_further_on_nothing_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ros1_bag(tmp_path / "old.bag")
    whole = data_files.read_bag

    def damaged(path: Path, topics: Any) -> Any:
        yield from islice(whole(path, topics), 2)
        raise ConfigError("is not a readable bag", file=str(path))

    monkeypatch.setattr(data_files, "read_bag", damaged)
    with pytest.raises(ConfigError, match="is not a readable bag"):
        record_bag(tmp_path / "old.bag", configuration(tmp_path), [tmp_path / "x.csv"])
    assert not (tmp_path / "x.csv").exists()


def test_a_bag_is_not_read_ahead_of_what_is_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[int] = []
    taken: list[int] = []

    def messages(path: Path, topics: Any) -> Any:
        for number in range(5):
            read.append(number)
            yield number / 10, "/joint_states", number

    class Node:
        done = False

        def take(self, number: int) -> None:
            taken.append(number)
            assert read == taken
            self.done = number == 2

        def wait(self, until: int) -> None: ...

        def close(self) -> None: ...

        handlers = property(lambda self: {"/joint_states": self.take})

    monkeypatch.setattr("fame.monitor.data_files.read_bag", messages)
    play(Path("bag"), lambda middleware, scheduler: Node(), {})  # type: ignore[type-var, return-value]
    assert taken == [0, 1, 2]


def test_the_command_records_a_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ros1_bag(tmp_path / "old.bag")
    configuration(tmp_path)
    command = ["monitor", "record", str(tmp_path / "joints.yaml"), "--bag", str(tmp_path / "old.bag"), "-o"]
    assert main([*command, str(tmp_path / "a.csv")]) == 0
    assert capsys.readouterr().out == f"{tmp_path}/a.csv: 3 rows, 1 run\n"
    assert main([*command, str(tmp_path / "a.csv")]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.long
def test_a_csv_file_is_whole_up_to_its_last_line_when_its_writer_is_killed(tmp_path: Path) -> None:
    """Killed while it writes as fast as it can."""
    configuration(tmp_path)
    code = f"""
import sys; sys.path[:0] = {sys.path!r}
from pathlib import Path
from test_pipeline_recording import Bench, configuration
bench = Bench()
node = bench.record(configuration(Path({str(tmp_path)!r})), Path({str(tmp_path / "a.csv")!r}))
for number in range(1, 10**9):
    bench.joints(number / 500, float(number), 2.0 * number)
    bench.run(0.002)
    if number == 500:
        print("going", flush=True)
"""
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert child.stdout is not None
    assert child.stdout.readline() == b"going\n"
    child.kill()
    child.communicate()
    (run,) = read_runs([tmp_path / "a.csv"])
    assert len(run) >= 450
    np.testing.assert_allclose(run.values[:, 1], 2 * run.values[:, 0])
    np.testing.assert_allclose(np.diff(run.values[:, 0]), 1)


# ---- a database ------------------------------------------------------------------------------------------------------


class Server:
    """What a server of the line protocol says and gets."""

    def __init__(self, port: int = 0, status: int = 204) -> None:
        self.lines: list[str] = []
        self.status = status
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"])).decode()
                status = 200 if self.path.startswith("/query") else outer.status
                if self.path.startswith("/write?db=robots&precision=ns") and status == 204:
                    outer.lines += body.splitlines()
                self.send_response(status)
                self.end_headers()

            def log_message(self, *_: object) -> None: ...

        self._server = HTTPServer(("127.0.0.1", port), Handler)
        self.port = self._server.server_port
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.01})
        self._thread.start()

    def stop(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def row(folder: Path, number: int) -> Row:
    ports = configuration(folder, Effort0={**ELBOW, "Field": ["effort", 0]}).inputs
    return Row(number / 10, 0, ports, [float(number)], [()])


def influx(folder: Path, port: int, said: list[str]) -> Influx:
    return Influx(f"http://127.0.0.1:{port}/robots", folder / "spool", "arm 1", said.append, pause=0.01)


def test_rows_go_to_a_database_by_line_protocol(tmp_path: Path) -> None:
    server, said = Server(), list[str]()
    try:
        sink = influx(tmp_path, server.port, said)
        for number in range(3):
            sink.put(row(tmp_path, number))
        sink.close()
    finally:
        server.stop()
    assert server.lines[1] == r"arm\ 1 Effort0=1.0,run=0i 100000000"
    assert (len(server.lines), said, list(tmp_path.glob("spool*"))) == (3, [], [])


def test_rows_without_a_date_are_of_the_day_of_their_recording(tmp_path: Path) -> None:
    server = Server()
    try:
        sink = Influx(f"http://127.0.0.1:{server.port}/robots", tmp_path / "spool", "a", print, origin=17 * 10**17)
        for each in (row(tmp_path, 5), row(tmp_path, 0)._replace(stamp=1.8e9)):
            sink.put(each)
        sink.close()
    finally:
        server.stop()
    assert [line.split()[-1] for line in server.lines] == ["1700000000500000000", "1800000000000000000"]


def test_nothing_is_lost_while_the_server_is_away(tmp_path: Path) -> None:
    server, said = Server(), list[str]()
    port = server.port
    server.stop()
    sink = influx(tmp_path, port, said)
    for number in range(50):
        sink.put(row(tmp_path, number))
        sink.flush()
    server = Server(port)
    try:
        sink.put(row(tmp_path, 50))
        sink.close()
    finally:
        server.stop()
    assert [float(line.split("=")[1].split(",")[0]) for line in server.lines] == list(range(51))
    assert said[0].startswith("the server cannot be reached (")
    assert said[-1] == "the server is available again; rows stored on disk are sent"


def test_what_could_not_be_sent_waits_on_disk_for_the_next_time(tmp_path: Path) -> None:
    server, said = Server(status=503), list[str]()
    try:
        sink = influx(tmp_path, server.port, said)
        sink.put(row(tmp_path, 1))
        sink.close(0.2)
        assert said[0].startswith("the server cannot be reached (HTTP 503)")
        assert f"bytes wait in {tmp_path}/spool.lines" in said[-1]
        server.status = 204
        sink = influx(tmp_path, server.port, said)
        sink.put(row(tmp_path, 2))
        sink.close()
    finally:
        server.stop()
    assert [line.split()[-1] for line in server.lines] == ["100000000", "200000000"]


def test_lines_that_the_server_refuses_are_kept_apart(tmp_path: Path) -> None:
    server, said = Server(status=400), list[str]()
    try:
        sink = influx(tmp_path, server.port, said)
        sink.put(row(tmp_path, 1))
        sink.close()
    finally:
        server.stop()
    assert said == [f"the server refuses 1 lines (HTTP 400); kept in {tmp_path}/spool.refused"]
    assert (tmp_path / "spool.refused").read_text().count("\n") == 1


@pytest.mark.parametrize(
    "url",
    [
        "http://localhost:8086",
        "influx://localhost/robots",
        "http:///robots",
        "http://localhost:abc/robots",
        "http://me:secret@localhost:8086/robots",
    ],
)
def test_an_address_without_a_database_is_refused(tmp_path: Path, url: str) -> None:
    with pytest.raises(ConfigError, match="expected http://host:8086/database"):
        Influx(url, tmp_path / "spool", "arm", print)


@pytest.mark.influx
@pytest.mark.skipif(shutil.which("influxd") is None, reason="needs InfluxDB 1.x: apt-get install influxdb")
def test_a_real_server_stores_every_row_though_it_goes_away_in_between(tmp_path: Path) -> None:
    port, backup = free_port(), free_port()
    settings = {
        "INFLUXDB_HTTP_BIND_ADDRESS": f"127.0.0.1:{port}", "INFLUXDB_BIND_ADDRESS": f"127.0.0.1:{backup}",
        "INFLUXDB_META_DIR": str(tmp_path / "meta"), "INFLUXDB_DATA_DIR": str(tmp_path / "data"),
        "INFLUXDB_DATA_WAL_DIR": str(tmp_path / "wal"), "INFLUXDB_REPORTING_DISABLED": "true",
    }  # fmt: skip

    def start() -> subprocess.Popen[bytes]:
        quiet = subprocess.DEVNULL
        child = subprocess.Popen(["influxd"], env={**os.environ, **settings}, stdout=quiet, stderr=quiet)
        for _ in range(3000):
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{port}/ping", timeout=60).close()
                return child
            except OSError:
                threading.Event().wait(0.02)
        raise AssertionError("influxd does not answer")

    def stop(child: subprocess.Popen[bytes]) -> None:
        child.send_signal(signal.SIGTERM)
        child.wait(60)

    said: list[str] = []
    child = start()
    try:
        sink = influx(tmp_path, port, said)
        for number in range(300):
            sink.put(row(tmp_path, number))
            sink.flush()
            if number == 100:
                stop(child)
            if number == 200:
                child = start()
        sink.close()
        query = urllib.parse.urlencode({"db": "robots", "q": 'SELECT count("Effort0"), sum("Effort0") FROM "arm 1"'})
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/query?{query}", timeout=60) as answer:
            (series,) = yaml.safe_load(answer.read())["results"][0]["series"]
    finally:
        stop(child)
    assert series["values"][0][1:] == [300, sum(range(300))]


def test_a_file_of_somebody_else_is_refused_untouched_even_without_a_line_end(tmp_path: Path) -> None:
    for text in ("my notes, one line", "a,b\n1,2\n3"):
        (tmp_path / "notes.csv").write_text(text)
        with pytest.raises(ConfigError, match="was not recorded by fame monitor record"):
            Bench().record(configuration(tmp_path), tmp_path / "notes.csv", append=True)
        assert (tmp_path / "notes.csv").read_text() == text
    (tmp_path / "notes.csv").write_text("stamp,r")  # killed within its header
    Bench().record(configuration(tmp_path), tmp_path / "notes.csv", append=True).close()


def test_names_with_commas_and_numbers_with_many_digits_come_back_from_the_csv(tmp_path: Path) -> None:
    bench = Bench()
    node = bench.record(configuration(tmp_path, Efforts=EFFORTS), tmp_path / "runs.csv")
    for stamp in (0.1, 0.2):
        bench.arm.publish(messages.create(JOINT_STATE, {
            "header": {"stamp": stamp}, "name": ["left, upper", "two\nlines"], "effort": [1763712345.123456, 1e-7],
        }))  # fmt: skip
    bench.run()
    node.close()
    (found,) = read_runs([tmp_path / "runs.csv"])
    assert found.names == ("Efforts.left, upper", "Efforts.two lines")
    np.testing.assert_allclose(found.values[0], [1763712345.123456, 1e-7], rtol=1e-15)


def test_a_spool_that_was_torn_is_mended_before_it_is_gone_on_with(tmp_path: Path) -> None:
    server = Server()
    (tmp_path / "spool.lines").write_text("arm a=1.0,run=0i 1\narm a=2.3")  # killed in the middle of 2.345
    try:
        sink = influx(tmp_path, server.port, [])
        sink.put(row(tmp_path, 2))
        sink.close()
    finally:
        server.stop()
    assert server.lines == ["arm a=1.0,run=0i 1", r"arm\ 1 Effort0=2.0,run=0i 200000000"]


def test_what_answers_but_speaks_no_http_counts_as_away(tmp_path: Path) -> None:
    said: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as other:

        def answer() -> None:
            with other.accept()[0] as line:
                line.recv(4096)
                line.sendall(b"SSH-2.0-nothing\r\n")

        thread = threading.Thread(target=answer)
        thread.start()
        sink = influx(tmp_path, other.getsockname()[1], said)
        sink.put(row(tmp_path, 1))
        sink.flush()
        thread.join()
        sink.close(0.2)
    assert said[0].startswith("the server cannot be reached (")
    assert "bytes wait in" in said[-1]


def test_a_name_with_a_line_break_stays_in_its_line(tmp_path: Path) -> None:
    server = Server()
    try:
        sink = influx(tmp_path, server.port, [])
        sink.put(row(tmp_path, 1)._replace(values=[np.ones(2)], names=[("a\nb", "c d")]))
        sink.close()
    finally:
        server.stop()
    assert server.lines == [r"arm\ 1 a\ b=1.0,c\ d=1.0,run=0i 100000000"]


def test_two_databases_get_every_row_and_neither_the_others_leavings(tmp_path: Path) -> None:
    servers = Server(), Server()
    urls = [f"http://127.0.0.1:{server.port}/robots" for server in servers]
    try:
        bench = Bench()
        node = bench.record(configuration(tmp_path, Efforts=EFFORTS), *urls)
        for number in range(1, 4):
            bench.joints(number / 10, 1.0, 2.0)
        bench.run()
        node.close()
    finally:
        for server in servers:
            server.stop()
    assert [len(server.lines) for server in servers] == [3, 3]
    assert list(tmp_path.glob(".*influx*")) == []


def recorded(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, Any]:
    code = main(["monitor", "record", *map(str, words), "--json"])
    return code, json.loads(capsys.readouterr().out)


def joints_bag(folder: Path, of: Configuration, *names: str) -> Path:
    """A message every 0.1 s, of one device after the other."""
    bag = BagWriter(folder / "bag", of.inputs, ["/joint_states"])
    for number in range(20):
        content = {"header": {"stamp": 1 + number / 10}, "name": [names[number % len(names)]], "effort": [1.0]}
        bag.put("/joint_states", 1 + number / 10, messages.create(JOINT_STATE, content))
    bag.close()
    return folder / "bag"


def test_a_recording_that_is_whole_is_completed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    of = configuration(tmp_path, Efforts=EFFORTS)
    code, found = recorded(capsys, of.file, "--bag", joints_bag(tmp_path, of, "elbow"), "-o", tmp_path / "a.csv")
    assert (code, found["status"], found["rows"], found["left_out"]) == (0, "completed", 20, [])
    assert found["stored"] == [{"output": str(tmp_path / "a.csv"), "rows": 20, "missing": 0, "reasons": []}]


@pytest.mark.parametrize(("field", "code"), [(["effort"], 3), (["effort", "elbow"], 0)])
def test_another_device_makes_a_recording_partial_unless_the_joints_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], field: list[str], code: int
) -> None:
    of = configuration(tmp_path, Efforts={**EFFORTS, "Field": field})
    bag = joints_bag(tmp_path, of, "elbow", "finger")
    found = recorded(capsys, of.file, "--bag", bag, "-o", tmp_path / "a.csv")
    assert (found[0], found[1]["rows"], found[1]["left_out"][0]["number"]) == (code, 10, 10)


def test_a_topic_without_columns_makes_a_recording_partial(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    of = configuration(tmp_path, Efforts=EFFORTS, Force=FORCE)
    bag = BagWriter(tmp_path / "bag", of.inputs, ["/joint_states", "/force"])
    for number in range(30):
        content = {"header": {"stamp": 1.0 + number}, "name": ["elbow"], "effort": [1.0]}
        bag.put("/joint_states", 1.0 + number, messages.create(JOINT_STATE, content))
        if number >= 20:
            bag.put("/force", 1.5 + number, messages.create("std_msgs/msg/Float64", 7))
    bag.close()
    out = tmp_path / "a.csv"
    code, found = recorded(capsys, of.file, "--bag", tmp_path / "bag", "-o", out)
    assert (code, found["status"], found["rows"]) == (3, "partial", 40)
    expected = {"output": str(out), "rows": 30, "missing": 10, "reasons": ["force has no columns"]}
    assert found["stored"] == [expected]
    assert main(["monitor", "record", str(of.file), "--bag", str(tmp_path / "bag"), "-o", str(tmp_path / "b.csv")]) == 3
    assert "b.csv: has 30 rows, 10 are missing: force has no columns" in capsys.readouterr().out


@pytest.mark.parametrize(("status", "reason"), [(401, "refused by the server"), (503, "waiting on disk")])
def test_rows_that_a_database_has_not_stored_make_a_recording_partial(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], status: int, reason: str
) -> None:
    of, server = configuration(tmp_path, Efforts=EFFORTS), Server(status=status)
    bag = joints_bag(tmp_path, of, "elbow")
    try:
        code, found = recorded(capsys, of.file, "--bag", bag, "-o", f"http://127.0.0.1:{server.port}/robots")
    finally:
        server.stop()
    assert (code, found["status"]) == (3, "partial")
    (stored,) = found["stored"]
    assert (stored["rows"], stored["missing"], stored["reasons"]) == (0, 20, [f"20 are {reason}"])


def test_how_many_lines_were_refused_in_all_is_said_at_the_end(tmp_path: Path) -> None:
    server, said = Server(status=400), list[str]()
    try:
        sink = influx(tmp_path, server.port, said)
        sink.put(row(tmp_path, 1))
        sink.flush()
        while not said:
            threading.Event().wait(0.01)
        for number in range(2, 5):
            sink.put(row(tmp_path, number))
        sink.close()
    finally:
        server.stop()
    assert said == [
        f"the server refuses 1 lines (HTTP 400); kept in {tmp_path}/spool.refused",
        f"the server has refused 4 lines in all; kept in {tmp_path}/spool.refused",
    ]


@pytest.mark.long
def test_a_disk_that_is_full_is_said_with_the_file_and_what_was_written_is_whole(tmp_path: Path) -> None:
    bag, (of, out) = tmp_path / "full.yaml", (configuration(tmp_path), tmp_path / "runs.csv")
    bag.write_text(of.file.read_text())
    code = (
        "import resource, sys\nsys.path.insert(0, 'tests')\nfrom pathlib import Path\n"
        "from test_pipeline_recording import Bench\n"
        "from fame.monitor.pipeline.configuration import load\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        f"bench = Bench(); node = bench.record(load({str(bag)!r}), Path({str(out)!r}))\n"
        "for number in range(1, 101):\n    bench.joints(number / 100, 1.0, 2.0)\n    bench.run()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert f"{out}: cannot be written: File too large" in done.stderr
    (found,) = read_runs([out])
    assert len(found) > 10


def test_stamps_of_two_clocks_leave_no_topic_without_its_columns(tmp_path: Path) -> None:
    bench = Bench()
    bench.scheduler.run(100 * SECOND)
    node = bench.record(configuration(tmp_path, Efforts=EFFORTS, Elbow=ELBOW, Force=FORCE), tmp_path / "runs.csv")
    bench.joints(5e8, 1.0, 2.0)
    bench.joints(6e8, 1.0, 2.0)
    bench.run()
    bench.force.publish(messages.create("std_msgs/msg/Float64", 3.0))
    bench.run()
    node.close()
    assert (tmp_path / "runs.csv").read_text().splitlines()[0].endswith(",Force")


def test_a_bag_with_a_pause_of_decades_is_read_at_once(tmp_path: Path) -> None:
    of, said = configuration(tmp_path, Efforts=EFFORTS), list[str]()
    bag = BagWriter(tmp_path / "bag", of.inputs, ["/joint_states"])
    for time in (1.0, 1.1, 1.7e9, 1.7e9 + 0.1):
        bag.put("/joint_states", time, messages.create(JOINT_STATE, {"header": {"stamp": time}, "effort": [1.0]}))
    bag.close()
    assert record_bag(tmp_path / "bag", of, [tmp_path / "runs.csv"], RecordingOptions(report=said.append)).rows == 4
    assert "joints: /joint_states: no message for 2 s" in said


@pytest.mark.parametrize("speed", [0.25, 1.0, 4.0])
def test_a_duration_counts_the_stamps_of_the_robot(tmp_path: Path, speed: float) -> None:
    """A world that is slower or faster than the clock of the recorder."""
    bench, ended = Bench(), list[float]()
    node = bench.record(configuration(tmp_path), tmp_path / "runs.csv")
    node.end_after(2.0, lambda: ended.append(bench.scheduler.now / SECOND))
    stamp = 100.0
    while not ended:
        bench.joints(stamp, 1.0, 2.0)
        bench.run(0.01 / speed)
        stamp += 0.01
    node.close()
    assert ended[0] == pytest.approx(2.0 / speed, abs=0.05 / speed)
    (run,) = read_runs([tmp_path / "runs.csv"])
    assert run.stamps[-1] - run.stamps[0] == pytest.approx(2.0, abs=0.02)


def test_a_duration_ends_when_a_robot_falls_silent(tmp_path: Path) -> None:
    bench, ended = Bench(), list[float]()
    node = bench.record(configuration(tmp_path), tmp_path / "runs.csv")
    node.end_after(2.0, lambda: ended.append(bench.scheduler.now / SECOND))
    bench.joints(1.0, 1.0, 2.0)
    bench.run(3.9)
    assert ended == []
    bench.run(0.2)
    assert ended == [pytest.approx(4.0)]
    node.close()
