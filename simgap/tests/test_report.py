"""Tables of reports on a narrow console."""

from simgap.common.report import ReportTable, print_parts


def test_a_column_of_numbers_is_not_wrapped(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "24")
    row = ("a joint with a long name", "12.3 mrad", "4.5 to 6.7 mrad")
    print_parts([ReportTable(("joint", "error", "90 %"), [row])])
    shown = capsys.readouterr().out
    assert row[1] in shown
    assert row[2] in shown
