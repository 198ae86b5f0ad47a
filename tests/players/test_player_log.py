"""What is said of a player's log once the player is gone."""

from trainer.players.failures import PlayerLogs

INFO = "2026-11-26 08:00:00,000 INFO Trainer package 0.28.0, seed 1, 4 areas."
ERROR = "2026-11-26 08:00:01,000 ERROR Flaky-v0 failed in a step (RuntimeError: the pole is broken)."


def test_a_log_that_stays_is_named_and_its_end_is_quoted_if_it_is_an_error(tmp_path):
    log = tmp_path / "Player-0.log"
    assert PlayerLogs(tmp_path).hint(log) == ""
    log.write_text(f"{INFO}\n")
    assert PlayerLogs(tmp_path).hint(log) == f" The player's log is {log}."
    log.write_text(f"{INFO}\n{ERROR}\n")
    said = PlayerLogs(tmp_path).hint(log)
    assert said.startswith(f" The player's log is {log}. The player's log ends: ")
    assert said.endswith(ERROR)


def test_of_a_log_that_does_not_stay_the_end_is_quoted(tmp_path):
    log = tmp_path / "Player-0.log"
    log.write_text(f"{INFO}\n")
    assert PlayerLogs(tmp_path, stay=False).hint(log) == f" The player's log ends: {INFO}"
