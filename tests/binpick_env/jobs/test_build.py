from binpick_env.jobs.build import build, differences


def test_a_build_has_versions_and_a_digest_and_nothing_of_the_machine() -> None:
    found = build()
    assert {"python", "binpick", "mujoco", "numpy", "binpick's files"} <= set(found)
    assert not {"platform", "cores"} & set(found)


def test_differences_name_both_versions() -> None:
    given, other = {"a": "1", "b": "2", "c": "3"}, {"a": "1", "b": "4", "d": "5"}
    assert differences(given, given) == []
    assert differences(given, other) == ["b: 2, 4", "c: 3, unknown", "d: unknown, 5"]
