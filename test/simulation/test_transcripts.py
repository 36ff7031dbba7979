"""The stories of the protocol in test/agreement/transcripts, which a newcomer reads: the robots still
do what they say. After a change that is meant, look at the difference that
``python3 -m agreement.transcript`` makes (see agreement/transcript.py)."""

import pytest

from agreement.transcript import FOLDER, Stanza, played, read, text_of

TRANSCRIPTS = sorted(FOLDER.glob("*.txt"))


@pytest.mark.parametrize("path", TRANSCRIPTS, ids=lambda path: path.stem)
def test_the_robots_do_what_the_transcript_says(path):
    assert text_of(played(read(path))) == path.read_text(encoding="utf-8")


def test_commands_without_an_answer_are_refused(tmp_path):
    path = tmp_path / "story.txt"
    path.write_text("# a story\nteam 2\nstart\n")
    with pytest.raises(ValueError, match="no ---- after: start"):
        read(path)
    path.write_text("# a story\nteam 2\n----\n")
    assert read(path) == [Stanza(["# a story"], ["team 2"], [])]
