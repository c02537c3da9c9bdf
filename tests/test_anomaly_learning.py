"""Learning: the file, the table, the best model, and how it is stored."""

import json
import pickle
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
import pytest

pytest.importorskip("sklearn")
pytest.importorskip("skops")

from arm_data import BENIGN, BOTH, needs_data, recording
from sklearn.linear_model import LogisticRegression
from sklearn.svm import SVC, OneClassSVM

from fame.cli import main
from fame.errors import ConfigError
from fame.monitor.anomaly.classifiers import _HOMES, HEADS, TRAIN, VALIDATION, OutputMatrix, expand_candidates, rows
from fame.monitor.anomaly.interface import Interface
from fame.monitor.anomaly.learn import best, checked, learn, read_data
from fame.monitor.anomaly.learning_file import load
from fame.monitor.anomaly.live import RunMonitor
from fame.monitor.anomaly.model import DataPersist, DataProcess, Model, data_hash
from fame.monitor.anomaly.recording import Recording, join, of_runs, read_csv, write_csv
from fame.monitor.calibration import calibrate_runs
from fame.monitor.judge import judge_recordings
from fame.monitor.model_card import card_of
from fame.monitor.storage import write_artefact
from fame.text import table

FILES = """
Files:
  fit_file: {name: benign.csv, input_col: [0, 1, 2], output_col: [3]}
  unsupervised_train: {name: benign.csv, input_col: [0, 1, 2], output_col: [3]}
  supervised_train: {name: both.csv, input_col: [0, 1, 2], output_col: [3]}
  testing:
    - {name: test.csv, input_col: [0, 1, 2], output_col: [3]}
Operations:
  reduction: 2
"""
CLASSIFIERS = """
Classifiers:
  - {name: one, class: OneClassSVM, parameters: {nu: 0.1, gamma: 5}, threshold: 0.5}
  - {name: two, class: SVC, parameters: {gamma: 20, C: 100}}
Split: {folds: 3}
"""


def circle(radius: float, random: np.random.Generator, points: int = 60) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, points)
    path = np.stack([radius * np.cos(angle), radius * np.sin(angle), 1 + 0 * angle], axis=1)
    return path + random.normal(0, 0.01, path.shape)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_task(tmp_path)


@cache
def learned():
    """What is learned from the files of the task as they are."""
    with TemporaryDirectory() as folder:
        return learn(load(write_task(Path(folder)) / "learning.yaml"))


def write_task(tmp_path: Path) -> Path:
    """A task that is a circle, and anomalies that are larger ones."""
    random = np.random.default_rng(1)
    names = ("a", "b", "c")
    benign = of_runs([circle(1.0, random) for _ in range(6)], 1, names)
    wrong = of_runs([circle(1.4, random) for _ in range(6)], -1, names)
    fresh = of_runs([circle(1.0, random) for _ in range(2)], 1, names)
    write_csv(tmp_path / "benign.csv", benign)
    write_csv(tmp_path / "both.csv", join([benign, wrong]))
    write_csv(tmp_path / "test.csv", join([fresh, of_runs([circle(1.4, random)], -1, names)]))
    (tmp_path / "learning.yaml").write_text(FILES + CLASSIFIERS)
    (tmp_path / "published.yaml").write_text(FILES)
    return tmp_path


def test_a_positive_is_an_anomaly():
    matrix = OutputMatrix().output_matrix([-1, -1, 1, 1, 1], [-1, 1, -1, 1, 1])
    assert tuple(matrix) == (1, 1, 2, 1)
    assert (matrix.accuracy, matrix.recall, matrix.precision, matrix.f1) == (0.6, 0.5, 0.5, 0.5)


def test_every_classifier_is_judged_on_train_validation_and_test():
    one, two = learned()
    assert [evaluation.data.split(":")[0] for evaluation in two.evaluations] == ["train", "validation", "test"]
    assert tuple(two.on(VALIDATION).runs) == (6, 0, 6, 0)
    assert tuple(two.evaluations[2].runs) == (1, 0, 2, 0)
    assert one.model.threshold == 0.5
    assert best([one, two]).on(VALIDATION).runs.f1 == 1.0


def test_a_run_in_which_a_joint_hardly_moves_is_not_benign(folder: Path):
    one, _ = learned()
    usual = circle(1.0, np.random.default_rng(7))
    dead = np.tile(usual[0], (60, 1))
    write_csv(folder / "new.csv", of_runs([usual, dead], 1, ("a", "b", "c")))
    judged = judge_recordings(one.model, [folder / "new.csv"], "m").runs
    assert [(run.verdict, run.share) for run in judged] == [("benign", 1.0), ("not judged", 0.0)]
    assert judged[1].notes == tuple(f"{joint} hardly moves: not judged" for joint in "abc")
    monitor = RunMonitor(one.model, rule="signal")
    monitor.begin()
    for values in dead.tolist():
        monitor.step(0.0, values)
    monitor.end()
    assert monitor.ended[0].text == "run 0: not judged, score 0.0000 (0 of 60 points), a, b, c hardly moved"
    earlier = replace(one.model, conditions={})
    assert judge_recordings(earlier, [folder / "new.csv"], "m").runs[1].verdict == "benign"


def test_automatic_threshold_lies_between_benign_and_anomalous_runs():
    _, two = learned()
    evaluations = two.on(VALIDATION)
    benign = [score for score, label in zip(evaluations.scores, evaluations.labels, strict=True) if label == 1]
    anomalous = [score for score, label in zip(evaluations.scores, evaluations.labels, strict=True) if label == -1]
    assert max(benign) <= two.model.threshold < min(anomalous)


def test_figures_from_training_data_say_so():
    text = table(HEADS, rows(learned(), best(learned())))
    assert "train (learned from)" in text
    assert all("learned from" in line for line in text.splitlines() if " train" in line)


def test_a_testing_file_that_was_learned_from_is_no_test(folder: Path):
    text = (folder / "learning.yaml").read_text().replace("test.csv", "both.csv")
    (folder / "learning.yaml").write_text(text)
    assert all(
        evaluation.data.startswith((TRAIN, VALIDATION))
        for evaluation in learn(load(folder / "learning.yaml"))[1].evaluations
    )


def test_the_grid_multiplies_parameters_and_reductions(folder: Path):
    grid = "Grid:\n  reduction: [0, 2]\n  two: {gamma: [5, 20]}\n"
    (folder / "learning.yaml").write_text(
        FILES + CLASSIFIERS.replace("Split: {folds: 3}", "Split: {folds: 0}\n" + grid)
    )
    (folder / "learning.yaml").write_text((folder / "learning.yaml").read_text() + "Threshold: 0.2\n")
    names = [item.candidate.name for item in learn(load(folder / "learning.yaml"))]
    assert names == ["one pca 0", "one pca 2", *(f"two gamma {g} pca {n}" for n in (0, 2) for g in (5, 20))]


def test_a_name_that_is_null_means_no_such_training(folder: Path):
    text = FILES.replace("supervised_train: {name: both.csv", "supervised_train: {name: Null")
    (folder / "published.yaml").write_text(
        text.replace("unsupervised_train: {name: Null", "unsupervised_train: {name: benign.csv")
    )
    found = learn(load(folder / "published.yaml"))
    assert [item.candidate.name for item in found] == ["ocsvm"]


def test_a_reduction_that_is_asked_for_holds_for_the_classifiers_of_the_paper(folder: Path):
    learning = load(folder / "published.yaml")
    assert [candidate.reduction for candidate in expand_candidates(learning)] == [2, 2]
    (folder / "published.yaml").write_text(FILES.replace("reduction: 2", "reduction: 0"))
    assert [candidate.reduction for candidate in expand_candidates(load(folder / "published.yaml"))] == [0, 3]
    (folder / "published.yaml").write_text(FILES + "Grid: {reduction: [0, 5, 4, 3, 2]}")
    tried = [candidate.reduction for candidate in expand_candidates(load(folder / "published.yaml"))]
    assert tried == [0, 5, 4, 3, 2] * 2


def test_files_with_other_joints_are_refused(folder: Path):
    headerless = (folder / "benign.csv").read_text().splitlines()[1:]
    (folder / "plain.csv").write_text("\n".join(line.split(",", 1)[1] for line in headerless))
    write_csv(folder / "test.csv", of_runs([np.ones((9, 3))], 1, ("a", "b", "other")))
    text = (folder / "learning.yaml").read_text().replace("fit_file: {name: benign.csv", "fit_file: {name: plain.csv")
    (folder / "learning.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"test\.csv: has the 3 joints a, b, other; expected the 3 of .*benign\.csv"):
        learn(load(folder / "learning.yaml"))


def test_progress_tells_what_is_done(folder: Path):
    told = []
    learn(load(folder / "learning.yaml"), progress=told.append)
    assert [item.done for item in told] == list(range(1, 9))
    assert {item.total for item in told} == {8}


def test_without_anomalous_runs_the_best_raises_the_fewest_false_alarms(folder: Path):
    text = (folder / "learning.yaml").read_text()
    text = text.replace("  supervised_train: {name: both.csv, input_col: [0, 1, 2], output_col: [3]}\n", "")
    worse = "  - {name: worse, class: OneClassSVM, parameters: {nu: 0.9, gamma: 5}, threshold: 0.5}"
    (folder / "learning.yaml").write_text(
        "\n".join(worse if "name: two" in line else line for line in text.splitlines())
    )
    one, worse_one = learn(load(folder / "learning.yaml"))
    assert best([worse_one, one]) is one


def published(folder: Path) -> Interface:
    """The first three steps of the published script."""
    interface = Interface(folder / "published.yaml", folder / "stored")
    interface.genmodel_train([("ocsvm", OneClassSVM(nu=0.1, gamma=5))], [("rbfsvm1", SVC(gamma=20, C=100))])
    return interface


def test_the_published_script_stores_classifiers_that_judge_as_they_did_in_it(
    folder: Path, capsys: pytest.CaptureFixture[str]
):
    unsupervised, supervised = published(folder).get_testing_predictions()
    assert (list(unsupervised[0]), list(supervised[0])) == (["ocsvm"], ["rbfsvm1"])
    assert (supervised[0]["rbfsvm1"] == np.repeat([1, 1, -1], 60)).mean() > 0.99
    printed = capsys.readouterr().out
    assert "train (learned from)" in printed
    for name, labels in {**unsupervised[0], **supervised[0]}.items():
        model = Model.load(folder / "stored" / f"{name}.skops")
        assert model.alarm_text() in printed
        assert model.predict(read_csv(folder / "test.csv")).tolist() == labels.tolist()
        judged = judge_recordings(model, [folder / "test.csv"], name)
        assert [run.verdict for run in judged.runs] == ["benign", "benign", "anomalous"]


def test_a_kind_of_classifiers_without_a_file_is_not_trained_and_this_is_said(
    folder: Path, capsys: pytest.CaptureFixture[str]
):
    text = FILES.replace("name: both.csv", "name: Null").replace("name: test.csv", "name: benign.csv")
    (folder / "published.yaml").write_text(text)
    assert published(folder).get_testing_predictions()[1] == [{}]
    printed = capsys.readouterr().out
    assert "Files.supervised_train names no file: not trained: rbfsvm1" in printed
    assert "threshold of the benign training runs: there are no anomalous testing runs" in printed
    assert {path.name for path in (folder / "stored").glob("*.skops")} == {"ocsvm.skops", "process.skops"}
    with pytest.raises(ConfigError, match="names no file to train these classifiers from"):
        Interface(folder / "published.yaml").genmodel_train([], [("rbfsvm1", SVC())])


def test_a_warning_of_many_fits_is_one_line(folder: Path, capsys: pytest.CaptureFixture[str]):
    mlp = (
        "Classifiers: [{name: mlp, class: MLPClassifier, parameters: {max_iter: 1}, threshold: 0.5}]\nSplit: {folds: 3}"
    )
    (folder / "learning.yaml").write_text(FILES + mlp)
    words = ["monitor", "adm", "learn", str(folder / "learning.yaml"), "-o", str(folder / "m.skops"), "--jobs", "1"]
    assert main([*words, "--json"]) == 0
    out, err = capsys.readouterr()
    (warned,) = [line for line in err.splitlines() if "Maximum iterations (1) reached" in line]
    assert warned.endswith("(4 of 4 fits)")
    assert json.loads(out)["warnings"][0] in warned


@pytest.mark.parametrize("name", ["ocsvm", "../ocsvm", ""])
def test_a_classifier_of_a_script_has_a_name_of_its_own_that_a_file_can_have(folder: Path, name: str):
    with pytest.raises(ConfigError, match=f"expected unique names that a file can have, got '{name}'"):
        Interface(folder / "published.yaml").genmodel_train([("ocsvm", OneClassSVM())], [(name, SVC())])


def test_what_was_kept_for_other_data_is_not_taken_again(folder: Path, tmp_path: Path):
    first = Interface(folder / "published.yaml", tmp_path / "kept").process
    assert np.allclose(
        Interface(folder / "published.yaml", tmp_path / "kept").process.scaler.scale_, first.scaler.scale_
    )
    write_csv(folder / "benign.csv", of_runs([circle(3.0, np.random.default_rng(2))], 1, ("a", "b", "c")))
    assert not np.allclose(
        Interface(folder / "published.yaml", tmp_path / "kept").process.scaler.scale_, first.scaler.scale_
    )
    with pytest.raises(ConfigError, match="is stale"):
        DataPersist(tmp_path / "kept").retrieve("process", "other")


# ---- stored models ---------------------------------------------------------------------------------------------------


def test_a_stored_model_judges_as_before_and_one_by_one_as_all_at_once(folder: Path):
    points = read_csv(folder / "test.csv")
    for item in learned():
        item.model.save(folder / "m.skops")
        model = Model.load(folder / "m.skops")
        together = model.predict(points)
        scorer = model.scorer()
        assert [-1 if scorer.step(row).anomalous else 1 for row in points.values.tolist()] == together.tolist()
        assert together.tolist() == item.model.predict(points).tolist()


def stored(folder: Path, **changes: object) -> Path:
    """A model file, with some of its content replaced."""
    import skops.io

    learned()[1].model.save(folder / "m.skops")
    content = skops.io.load(folder / "m.skops", trusted=[])
    skops.io.dump({**content, **changes}, folder / "m.skops")
    return folder / "m.skops"


class Strange(LogisticRegression):
    """A class that is none of scikit-learn's."""


def test_a_model_with_code_is_refused(folder: Path):
    with pytest.raises(ConfigError, match=r"refused: it contains code or unknown classes \(.*Strange"):
        Model.load(stored(folder, detector=Strange()))


@pytest.mark.parametrize("content", [pickle.dumps([1]), pickle.dumps([1], protocol=0)])
def test_a_pickle_is_refused_as_what_it_is(content: bytes, tmp_path: Path):
    (tmp_path / "chosen_clf.pkl").write_bytes(content)
    with pytest.raises(ConfigError, match="it is a pickle, refused since reading one runs what it holds"):
        Model.load(tmp_path / "chosen_clf.pkl")


def test_a_model_of_another_version_is_refused(folder: Path):
    with pytest.raises(
        ConfigError, match=r"was made with scikit-learn 0\.1\.0, here is .*fame monitor adm learn makes it anew"
    ):
        Model.load(stored(folder, versions={"scikit-learn": "0.1.0"}))


def test_a_damaged_model_is_refused(folder: Path):
    with pytest.raises(ConfigError, match=r"is damaged: .*reference of shape"):
        Model.load(stored(folder, joints=["a"]))


@pytest.mark.parametrize(
    "changes",
    [{"detector": 5}, {"detector": {"kind": "classifier"}}, {"reference": np.zeros((0, 3))}, {"nominal": "x"}],
)
def test_parts_that_do_not_fit_are_damage(folder: Path, changes: dict[str, object]):
    with pytest.raises(ConfigError, match="is damaged: "):
        Model.load(stored(folder, **changes))


def test_a_model_that_names_no_versions_is_refused(folder: Path):
    with pytest.raises(ConfigError, match="made with scikit-learn unknown"):
        Model.load(stored(folder, versions=None))


@pytest.mark.parametrize("within", [False, True])
def test_a_file_that_would_unpack_to_much_more_than_it_is_is_refused_before(folder: Path, within: bool):
    stored(folder)
    path, inner = folder / "m.skops", folder / "inner.npz"
    target = inner if within else path
    with ZipFile(target, "w" if within else "a", ZIP_DEFLATED) as packed, packed.open("1.npy", "w") as member:
        for _ in range(60):
            member.write(bytes(1_000_000))
    if within:
        with ZipFile(path, "a") as outer:
            outer.write(inner, "2.npz")
    with pytest.raises(ConfigError, match="would unpack to 60 MB; at most"):
        Model.load(path)


# ---- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "reduction: 2",
            "reductoin: 2",
            r"learning\.yaml:\d+: Operations.reductoin: unknown key; did you mean 'reduction'",
        ),
        ("reduction: 2", "reduction: 9", r"reduction: expected 0 \(none\) or 1 to"),
        ("class: SVC", "class: Magic", r"learning\.yaml:\d+: Classifiers\[1\]\.class: expected one of .*, got 'Magic'"),
        (
            "{gamma: 20, C: 100}",
            "{gama: 20}",
            r"yaml:\d+: Classifiers\[1\]\.parameters: expected the parameters of SVC: .*gama",
        ),
        ("threshold: 0.5", "threshold: 5", r"Classifiers\[0\].threshold: expected a number from 0 to 1, got 5"),
        ("both.csv", "benign.csv", "has benign points only"),
        ("folds: 3", "folds: 9", "at least 9 are needed"),
        ("folds: 3", "folds: 1", r"Split\.folds: expected 0 \(no validation\) or at least 2, got 1"),
        ("reduction: 2", "scaling: log", r"Operations\.scaling: expected a scaling, got 'log'; .*minmax"),
        ("nu: 0.1", "nu: 7", r"benign\.csv: OneClassSVM cannot be trained on these data: .*'nu'"),
        ("Split: {folds: 3}", "Grid: {reduction: 2}", r"Grid\.reduction: expected a list of values to try such as"),
        ("Split: {folds: 3}", "Grid: {two: {gamma: 5}}", r"Grid\.two\.gamma: expected a list of values to try, got 5"),
        (
            "test.csv, input_col: [0, 1, 2]",
            "test.csv, input_col: [0, 1]",
            r"test\.csv: has the 2 joints a, b; expected the 3 of",
        ),
    ],
)
def test_a_wrong_learning_file_is_refused(folder: Path, old: str, new: str, message: str):
    path = folder / "learning.yaml"
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ConfigError, match=message):
        learn(load(path))


def test_fewer_points_than_columns_are_refused_with_their_file(folder: Path):
    write_csv(folder / "benign.csv", of_runs([np.ones((2, 3))], 1, ("a", "b", "c")))
    with pytest.raises(ConfigError, match=r"benign\.csv: has 2 points of 3 columns"):
        learn(load(folder / "learning.yaml"))
    with pytest.raises(ConfigError, match="has 2 points of 3 columns"):
        DataProcess().fit(np.ones((2, 3)))


def test_the_hash_tells_data_apart(folder: Path):
    points = read_csv(folder / "test.csv")
    assert data_hash(points) != data_hash(points.select([0]))


@pytest.mark.long
@needs_data
def test_the_one_class_svm_of_the_paper_by_resubstitution():
    from fame.monitor.anomaly.classifiers import DEFAULTS, by_run, fit, make, run_scores

    candidate, benign, both = DEFAULTS[0], recording(BENIGN), recording(BOTH)
    detector = make(candidate, Path())
    detector.process.fit(benign.values)
    fit(detector, benign)
    scores = run_scores(both, detector.predict(both))
    assert tuple(by_run(both.run_labels(), scores, 0.22)) == (20, 2, 28, 0)


LEARNING = "Files: {supervised_train: {name: runs.csv, input_col: [0, 1], output_col: [2]}}\n"
CHAIN = "{joints: [{name: a, origin: [0, 0, %s], axis: [0, 0, 1]%s}]}"
JOINT = "origin: [0, 0, 1], axis: [0, 0, 1]"
TWO = "{joints: [{name: a, " + JOINT + "}, {name: %s, " + JOINT + "%s}]}"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (LEARNING + "Classifiers: 5", "Classifiers: expected a list, got 5"),
        (LEARNING + "Classifiers: [{name: x, class: SVC, unique: 'no'}]", "unique: expected true or false, got 'no'"),
        (LEARNING + "Classifiers: [{name: x, class: None}]", "got 'None'"),
        (LEARNING + "Operations: {reduction: 7}\nThreshold: 0.1", "components, got 7"),
        (
            LEARNING.replace("[0, 1]", "[0, 2]"),
            "input_col: expected columns without the label (output_col 2), got [0, 2]",
        ),
        (LEARNING.replace("[0, 1]", "[0, 0]"), "input_col: expected each column once, got [0, 0]"),
        (LEARNING.replace("[2]", "[2, 3]"), "output_col: expected one column, got [2, 3]"),
        *(
            (LEARNING + f"Classifiers: [{{name: x, class: PathDetector, parameters: {{chain: {chain}}}}}]", why)
            for chain, why in (
                (CHAIN % (".nan", ""), "not finite"),
                (CHAIN % (0, ", steps: 0"), "expected a number of steps per revolution, got 0"),
                (CHAIN % ("9" * 400, ""), "is not an arm"),
                ("{joints: []}", "is not an arm"),
                (TWO % ("a", ""), "each joint has a name of its own"),
                (TWO % ("b", ", steps: 4096"), "all or none have steps"),
                (TWO % ("b", ""), "benign run 0 has 6 points that are not all 0; at least 8 are needed"),
                (CHAIN % (0, "") + ", margin: wide", "parameters.margin: expected a number above 0, got 'wide'"),
                (CHAIN % (0, ""), "expected 1 joints, as the chain of the PathDetector has, got 2"),
            )
        ),
    ],
)
def test_every_wrong_learning_file_is_one_line_that_names_a_file(text: str, why: str, tmp_path: Path) -> None:
    rows = [f"{run},{0.1 * step + run},{step % 3},{1 if run < 6 else -1}" for run in range(12) for step in range(6)]
    (tmp_path / "runs.csv").write_text("\n".join(["run,a,b,label", *rows]) + "\n")
    (tmp_path / "wrong.yaml").write_text(text)
    with pytest.raises(ConfigError, match=re.escape(why)) as caught:
        learn(load(tmp_path / "wrong.yaml"))
    assert str(caught.value).startswith(str(tmp_path))


def test_a_grid_may_vary_the_classifiers_that_are_tried_without_any_named(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(LEARNING + "Grid: {rbfsvm: {gamma: [1, 2]}}")
    assert [candidate.parameters["gamma"] for candidate in expand_candidates(load(tmp_path / "a.yaml"))] == [1, 2]


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
def test_every_classifier_that_may_be_named_is_the_same_each_time_and_comes_back_from_its_file(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    runs = [random.normal(3.0 * (run >= 4), 1, (12, 2)) for run in range(8)]
    rows = [f"{run},{a},{b},{1 if run < 4 else -1}" for run, points in enumerate(runs) for a, b in points]
    (tmp_path / "runs.csv").write_text("\n".join(["run,a,b,label", *rows]) + "\n")
    names = [name for name in _HOMES if name != "EllipticEnvelope"]
    few = {"IsolationForest": "n_estimators: 3", "RandomForestClassifier": "n_estimators: 3",
           "HistGradientBoostingClassifier": "max_iter: 2, min_samples_leaf: 2", "MLPClassifier": "max_iter: 50",
           "LogisticRegression": "max_iter: 500"}  # fmt: skip
    named = [f"{{name: {name}, class: {name}, parameters: {{{few.get(name, '')}}}}}" for name in names]
    source = "{name: runs.csv, input_col: [0, 1], output_col: [2]}"
    both = f"Files: {{unsupervised_train: {source}, supervised_train: {source}}}\n"
    (tmp_path / "a.yaml").write_text(both + f"Classifiers: [{', '.join(named)}]\nSplit: {{folds: 0}}\nThreshold: 0.4\n")
    first, second = learn(load(tmp_path / "a.yaml")), learn(load(tmp_path / "a.yaml"))
    for one, other in zip(first, second, strict=True):
        assert one.evaluations == other.evaluations, one.candidate.name
        one.model.save(tmp_path / "one.skops")
        other.model.save(tmp_path / "other.skops")
        assert (tmp_path / "one.skops").read_bytes() == (tmp_path / "other.skops").read_bytes(), one.candidate.name
        points = of_runs(runs, 1, ("a", "b"))
        np.testing.assert_array_equal(Model.load(tmp_path / "one.skops").predict(points), one.model.predict(points))


def test_a_classifier_that_could_not_be_read_back_is_not_stored(tmp_path: Path) -> None:
    class Own:
        pass

    with pytest.raises(ConfigError, match="could not be read back as data"):
        write_artefact({"estimator": Own()}, tmp_path / "own.skops")
    assert list(tmp_path.iterdir()) == []


def test_the_threshold_is_told_in_points_and_the_card_says_what_was_learned():
    model = replace(best(learned()).model, threshold=0.002, nominal=496)
    assert model.alarm_text() == "alarm from 1 anomalous point of a run of 496 on"
    assert model.alarm_text(0.0021) == "alarm from 2 anomalous points of a run of 496 on"
    card = card_of(model)
    assert card["Threshold"]["in points"] == model.alarm_text()
    assert card["Data"]["sha256"] == model.data
    assert any("sees single points" in text for text in card["Limits"])


# ---- a stated rate of false alarms, and classifiers together ---------------------------------------------------------

TOGETHER = """
Classifiers:
  - {name: one, class: OneClassSVM, parameters: {nu: 0.1, gamma: 5}, threshold: 0.5}
  - {name: two, class: SVC, parameters: {gamma: 20, C: 100}, threshold: 0.2}
  - {name: either, class: "any of one, two"}
  - {name: both, class: "all of one, two"}
Split: {folds: 3}
"""


def test_thresholds_promise_a_rate_of_false_alarms(folder: Path):
    (folder / "learning.yaml").write_text(FILES + CLASSIFIERS + "FalseAlarms: 0.2 per run\n")
    one, two = learn(load(folder / "learning.yaml"))
    for item in (one, two):
        calibration = item.model.calibration
        assert calibration.promised == pytest.approx(1 / 7)  # 6 runs
        held = item.on(VALIDATION)
        benign = [score for score, label in zip(held.scores, held.labels, strict=True) if label == 1]
        assert item.model.threshold == max(benign + ([0.5] if item is one else []))  # a given one is the least
    card = card_of(one.model)
    assert card["False alarms"]["promise"].startswith(
        "at most 0.14 false alarms per run on average over trainings, with 90 % confidence at most 0.32, by 6 runs "
    )
    assert card["False alarms"]["bound per run of 90 % of models"] == pytest.approx(1 - 0.1 ** (1 / 6))
    assert card["False alarms"]["measured per run"] == 0.0
    for scores, far in ((np.zeros(6), True), (np.full(6, 0.1), True), (np.full(6, 0.2), False)):
        given = replace(one.model, calibration=calibrate_runs(scores, 0.2, least=0.5))
        text = f"lies far above the largest score of a left-out benign run ({scores.max():.4g})"
        assert any(text in limit for limit in card_of(given)["Limits"]) == far


def test_a_rate_that_the_runs_cannot_promise_is_told(folder: Path):
    (folder / "learning.yaml").write_text(FILES + CLASSIFIERS + "FalseAlarms: 0.01 per run\n")
    for item in learn(load(folder / "learning.yaml")):
        assert "6 runs promise 0.14 per run at best, 99 are needed" in item.note
        assert card_of(item.model)["False alarms"]["promised per run"] is None


@pytest.mark.parametrize(("rises", "steps"), [(0.0, 0.0), (0.02, 0.0), (0.0, 0.3)])
def test_runs_that_drift_are_told_and_stand_on_the_card(
    folder: Path, capsys: pytest.CaptureFixture[str], rises: float, steps: float
):
    random = np.random.default_rng(3)
    runs = [circle(1.0, random) + rises * number + steps * (number > 9) for number in range(15)]
    write_csv(folder / "benign.csv", of_runs(runs, 1, ("a", "b", "c")))
    single = re.sub(r"  supervised_train.*\n|  testing:\n.*\n", "", FILES) + CLASSIFIERS.replace("  - {name: two", "#")
    (folder / "learning.yaml").write_text(single + "FalseAlarms: 0.2 per run\n")
    words = ["monitor", "adm", "learn", str(folder / "learning.yaml"), "-o", str(folder / "m.skops"), "--jobs", "1"]
    assert main(words) == 0
    said, limits = capsys.readouterr().err, card_of(Model.load(folder / "m.skops"))["Limits"]
    found = [text for text in limits if "drift" in text or "runs before" in text]
    assert all(f"warning: {text}" in said for text in found)
    levels = "levels drift from run to run: later runs may raise more alarms than promised: "
    late = "5 of the last 5 runs exceed thresholds by the runs before; expected: 0.91"
    assert [text.startswith((levels, late)) for text in found] == [True] * ((rises > 0) + 2 * (steps > 0))
    assert (late in found) == (steps > 0)


def test_copies_of_runs_count_once_in_what_is_promised(folder: Path):
    for name in ("benign.csv", "both.csv"):
        given = read_csv(folder / name)
        write_csv(folder / name, join([given, given]))
    (folder / "learning.yaml").write_text(FILES + CLASSIFIERS + "FalseAlarms: 0.2 per run\n")
    learning = load(folder / "learning.yaml")
    for item in learn(learning):
        assert (item.model.calibration.runs, len(item.model.conditions["run_hashes"])) == (6, 12)
    assert any("12 of 24 runs are copies of others (run 12 of run 0)" in note for note in read_data(learning).notes)


def test_classifiers_complement_each_other(folder: Path):
    (folder / "learning.yaml").write_text(FILES + TOGETHER)
    one, two, either, both = learn(load(folder / "learning.yaml"))
    for item, combine in ((either, max), (both, min)):
        members = zip(one.on(VALIDATION).scores, two.on(VALIDATION).scores, strict=True)
        wanted = [combine(a / 0.5, b / 0.2) for a, b in members]
        assert item.on(VALIDATION).scores == pytest.approx(wanted)
        assert item.model.threshold == 1.0
        assert tuple(item.on(VALIDATION).runs)[:2] == (6, 0)


def test_a_combination_is_stored_and_scores_run_by_run_as_before(folder: Path, tmp_path: Path):
    (folder / "learning.yaml").write_text(FILES + TOGETHER + "FalseAlarms: 0.2 per run\n")
    *_, either, _ = learn(load(folder / "learning.yaml"))
    either.model.save(tmp_path / "either.skops")
    again = Model.load(tmp_path / "either.skops")
    assert again.calibration.promised == either.model.calibration.promised
    assert "any of one: alarm from" in again.alarm_text()
    assert card_of(again)["Model"]["detector"] == "either (any of one, two)"
    test = either.evaluations[-1]
    for run, score, label in zip(read_csv(folder / "test.csv"), test.scores, test.labels, strict=True):
        monitor = RunMonitor(again, rule="signal")
        monitor.begin()
        for row in run.values.tolist():
            monitor.step(0.0, row)
        monitor.end()
        report = monitor.ended[-1]
        assert report.score == pytest.approx(score)
        assert report.above == (label == -1)


@pytest.mark.parametrize("wrong", ["any of one", "any of one, three", "all of either, one"])
def test_a_combination_of_what_is_not_there_is_refused(folder: Path, wrong: str):
    (folder / "learning.yaml").write_text(FILES + TOGETHER.replace("all of one, two", wrong))
    with pytest.raises(ConfigError, match=r"two or more classifiers of this file \(one, two\)") as error:
        load(folder / "learning.yaml")
    assert error.value.line


def test_a_rate_needs_held_out_runs(folder: Path):
    text = FILES + CLASSIFIERS.replace("folds: 3", "folds: 0") + "Threshold: 0.2\nFalseAlarms: 0.2 per run\n"
    (folder / "learning.yaml").write_text(text)
    with pytest.raises(ConfigError, match="FalseAlarms needs held-out benign runs"):
        learn(load(folder / "learning.yaml"))


# ---- data that are odd -----------------------------------------------------------------------------------------------


def odd(runs: list[np.ndarray], labels: list[int]) -> Recording:
    names = ("a", "b", "c")
    return replace(
        join([of_runs([run], label, names) for run, label in zip(runs, labels, strict=True)]), source="x.csv"
    )


def test_joints_that_never_move_and_runs_of_other_tasks_are_told():
    random = np.random.default_rng(5)
    runs = [np.column_stack([random.normal(size=(points, 2)), np.ones(points)]) for points in (20, 60)]
    first, second = checked(odd(runs, [1, 1])).notes[-2:]
    assert first == "x.csv: c never moved"
    assert second == "x.csv: runs have from 20 to 60 points: are they of the same task?"


def test_where_nothing_moves_there_is_nothing_to_learn():
    with pytest.raises(ConfigError, match="no joint ever moves"):
        checked(odd([np.ones((20, 3))] * 2, [1, 1]))


def test_labels_that_contradict_each_other_are_refused():
    random = np.random.default_rng(6)
    run, other = random.normal(size=(20, 3)), random.normal(size=(20, 3))
    with pytest.raises(ConfigError, match="runs 0 and 2 are the same points, one labelled 1, the other -1"):
        checked(odd([run, other, run], [1, 1, -1]))
    mixed = odd([run, other], [1, 1])
    mixed.labels[30:] = -1
    with pytest.raises(ConfigError, match="run 1 has points of both labels"):
        checked(mixed)
