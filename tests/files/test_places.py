"""Datasets in an object store, by a real server of S3's protocol on this machine."""

from __future__ import annotations

import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from small_trainings import small_training
from tally import Tally

from neuroanimator import DatasetConfig, generate, read_diverged, read_transitions
from neuroanimator.errors import ArgumentError, BadFileError, ResourceError
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.files.places import UrlPath, place_of
from neuroanimator.learn.evaluation.weakness.coverage import coverage

SIX_THOUSAND = DatasetConfig(system="pendulum", count=6000)
DRIVER = "no driver for S3: pip install 'neuroanimator[s3]'"
KEYS = {
    "AWS_ACCESS_KEY_ID": "nobody-at-all",
    "AWS_SECRET_ACCESS_KEY": "a-secret-nobody-may-see",
    "AWS_DEFAULT_REGION": "us-east-1",
    "AWS_EC2_METADATA_DISABLED": "true",
}

pytestmark = pytest.mark.filterwarnings("default")  # those of the server and the driver


@pytest.fixture(scope="module")
def s3() -> Iterator[str]:
    """The address of a server with an empty bucket called `bucket`."""
    pytest.importorskip("s3fs", reason=DRIVER)
    moto_server = pytest.importorskip("moto.server", reason="no moto: run make setup")
    import s3fs

    server = moto_server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as changed:
        for name, value in KEYS.items():
            changed.setenv(name, value)
        changed.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        changed.setenv("AWS_CONFIG_FILE", "/nowhere")
        changed.setenv("AWS_SHARED_CREDENTIALS_FILE", "/nowhere")
        s3fs.S3FileSystem(use_listings_cache=False).mkdir("bucket")
        yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture
def no_kept_driver(s3: str) -> Iterator[str]:
    """Drivers keep the credentials they began with; this lets them look again."""
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    yield s3
    s3fs.S3FileSystem.clear_instance_cache()


def check_same(dataset: Path, place: UrlPath) -> None:
    paths = sorted(dataset.glob("*.*s*"))
    assert len(paths) == 3
    for path in paths:
        assert (place / path.name).read(2**26) == path.read_bytes()


def test_f20_a_dataset_in_a_bucket_is_the_same_bytes(s3: str, dataset: Path):
    url = "s3://bucket/set-2"
    with LocalExecutor(2) as executor:
        assert generate(SIX_THOUSAND, url, executor=executor) == 0
    check_same(dataset, UrlPath(url))
    assert len(read_transitions(url).states) == 6000 // 12 * 12
    assert not coverage(url).missing
    assert len(read_diverged(url)[0]) == 0


def test_the_command_line_takes_urls(s3: str, cli, tmp_path: Path):
    url = "s3://bucket/by-hand"
    made = cli("generate", "pendulum", "--count", 1200, "--samples-per-run", 12, "--out", url)
    assert made.returncode == 0, made.stderr
    assert made.stdout.split()[-2:] == ["folder", url]
    told = cli("info", url)
    assert "1 of 1 made" in told.stdout
    trained = cli(
        "train",
        url,
        *small_training(250, "4", 64),
        "--out",
        tmp_path / "p.emulator.safetensors",
    )
    assert trained.returncode == 0, trained.stderr
    refused = cli("train", "s3://me:secret@bucket/set", "--out", tmp_path / "q")
    assert refused.returncode == 2
    assert "the URL holds credentials or a query" in refused.stderr
    assert "secret" not in refused.stderr


def test_a_dataset_in_memory_goes_on_where_it_was_and_mends_what_is_damaged(dataset: Path):
    pytest.importorskip("fsspec", reason=DRIVER)
    place = UrlPath("memory://bucket/set")
    generate(SIX_THOUSAND, "memory://bucket/set/")
    check_same(dataset, place)
    shard = place / "shard-00001.safetensors"
    content = shard.read(2**26)
    shard.write(content[:-10])
    with pytest.raises(BadFileError, match="memory://bucket/set/shard-00001"):
        read_transitions(str(place))
    generate(SIX_THOUSAND, str(place))
    assert shard.read(2**26) == content
    with pytest.raises(BadFileError, match="set holds another dataset .*seed 0 there, 1 asked"):
        generate(DatasetConfig(system="pendulum", count=6000, seed=1), str(place))


@pytest.mark.parametrize("url", ["s3://bucket/claimed", "memory://bucket/claimed"])
def test_of_two_that_claim_a_folder_one_alone_succeeds(s3: str, url: str):
    place = UrlPath(url)
    assert not place.exists()
    assert place.create(b"first")
    assert not place.create(b"second")
    assert place.read(10) == b"first"
    with pytest.raises(BadFileError, match="more than 3 bytes"):
        place.read(3)


def test_a_url_of_this_machine_is_a_folder(tmp_path: Path):
    assert place_of(f"file://{tmp_path}/set") == tmp_path / "set"
    assert place_of(f"file://localhost{tmp_path}/set") == tmp_path / "set"
    for url in ("file://elsewhere/set", "file://set", "file://localhost", "file://localhost/"):
        with pytest.raises(ArgumentError, match=f"'{url}': wanted a folder on this machine"):
            place_of(url)
    assert place_of("a/folder") == Path("a/folder")
    assert place_of(tmp_path) == tmp_path


def test_a_command_keeps_nothing_in_its_own_memory(cli):
    refused = cli("generate", "pendulum", "--count", 12, "--out", "memory://bucket/set")
    assert refused.returncode == 2
    assert (
        "out: what is put into memory://bucket/set is lost when this command ends" in refused.stderr
    )


def test_what_is_not_there_is_said(s3: str):
    with pytest.raises(BadFileError, match="s3://bucket/nothing is not a dataset"):
        read_transitions("s3://bucket/nothing")
    with pytest.raises(ResourceError, match="no such bucket"):
        generate(SIX_THOUSAND, "s3://no-bucket-of-ours/set")


def test_without_credentials_one_line_says_where_to_put_them(
    no_kept_driver: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    with pytest.raises(ResourceError, match="^s3://bucket/set/.*: no credentials. Put credentials"):
        generate(SIX_THOUSAND, "s3://bucket/set")


def test_credentials_that_are_refused_are_not_repeated(no_kept_driver: str):
    asks_for_keys(no_kept_driver, "0")
    try:
        with pytest.raises(ResourceError, match="access refused") as raised:
            generate(SIX_THOUSAND, "s3://bucket/set")
    finally:
        asks_for_keys(no_kept_driver, "inf")
    assert not any(key in str(raised.value) for key in KEYS.values())


def asks_for_keys(server: str, after: str) -> None:
    """Let the server check keys from then on."""
    request = urllib.request.Request(
        f"{server}/moto-api/reset-auth", after.encode(), {"Content-Type": "text/plain"}
    )
    urllib.request.urlopen(request).close()


def test_a_store_that_does_not_answer_is_said(no_kept_driver: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    with pytest.raises(ResourceError, match="does not answer as it should"):
        read_transitions("s3://bucket/set")


@pytest.mark.parametrize(
    "url",
    [
        "s3://user:very-secret@bucket/set",
        "https://user:very-secret@host/set",
        "s3://bucket/set?X-Amz-Signature=very-secret",
    ],
)
def test_credentials_in_a_url_are_refused_and_not_repeated(url: str, tally: Tally):
    with pytest.raises(ArgumentError, match="the URL holds credentials or a query") as raised:
        generate(SIX_THOUSAND, url)
    assert "very-secret" not in str(raised.value)
    assert "user" not in str(raised.value)


@pytest.mark.parametrize(
    "url", ["s3://", "simplecache::s3://bucket/set", "s3://b/\x1b[2J", "s3:/b"]
)
def test_what_is_no_url_is_refused(url: str):
    with pytest.raises(ArgumentError, match="wanted a URL such as s3://bucket/folder"):
        place_of(url)


def test_a_url_that_was_made_a_path_is_refused():
    with pytest.raises(ArgumentError, match="Give it as a string"):
        place_of(Path("s3://bucket/set"))


def test_without_the_driver_the_line_that_installs_it_is_said(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(ResourceError, match="pip install 'neuroanimator\\[s3\\]'"):
        read_transitions("s3://bucket/set")


def test_a_scheme_without_a_driver_is_refused():
    pytest.importorskip("fsspec", reason=DRIVER)
    with pytest.raises(ArgumentError, match="no driver for 's4'"):
        read_transitions("s4://bucket/set")


def test_data_of_a_model_in_a_plain_folder_need_no_driver_and_no_signal_processing(tmp_path: Path):
    program = (
        "import sys, neuroanimator as na\n"
        f"na.generate(na.DatasetConfig(system='pendulum', count=12), {str(tmp_path)!r})\n"
        "unwanted = {'fsspec', 'ray', 'scipy.signal', 'scipy.interpolate'}\n"
        "sys.exit(' '.join(unwanted & set(sys.modules)) or None)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
