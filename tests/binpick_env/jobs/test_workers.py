import pytest

from binpick_env.jobs.workers import Cluster, is_positive


@pytest.mark.parametrize("address", ["local", "auto", "127.0.0.1:6379", "head.example:10001"])
def test_an_address_is_a_word_or_a_host_with_its_port(address: str) -> None:
    assert Cluster(address=address).address == address


@pytest.mark.parametrize("address", ["", "Local", "head", "head:", "ray://head:10001", "a b:1"])
def test_another_address_is_refused(address: str) -> None:
    with pytest.raises(ValueError, match=f"cluster must be local, auto or host:port, got {address!r}"):
        Cluster(address=address)


def test_a_cluster_without_a_process_is_refused() -> None:
    with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
        Cluster(address="local", workers=0)


def test_a_cluster_or_one_process_is_enough() -> None:
    assert is_positive(1)
    assert is_positive(Cluster())
    assert not is_positive(0)
    assert Cluster() != 1  # evaluations compute on all cores with 1 alone
