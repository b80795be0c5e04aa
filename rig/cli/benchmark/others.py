"""`rig benchmark others`: foreign clients and file readers."""

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.benchmark.tables import ReadmeOption
from rig.cli.common import Exit, JsonOption, emit_json, say


def others(
    part: Annotated[
        list[str] | None, typer.Option("--part", help="clients or files; repeat. Default: both.")
    ] = None,
    clones: Annotated[
        Path | None,
        typer.Option("--clones", help="Folder with clones of public repositories, as OWNER/NAME."),
    ] = None,
    session: Annotated[
        Path | None, typer.Option("--session", help="A session of rig trial, whose files are opened.")
    ] = None,
    readme: ReadmeOption = None,
    json: JsonOption = False,
) -> None:
    """Run foreign clients on the simulated devices, and foreign readers on the files of a session.

    Each client and reader is a package or clone that does not come with the rig. If it is missing, it is
    skipped, and its row says how to install it. All connections are on loopback. See docs/others.md. Exit
    code 4 if a result is not as expected.

    Examples:
      rig benchmark others --part clients

      rig benchmark others --clones clones/ --session my_session --json

    """
    from rig.benchmark.others.benchmark import Sources, as_json, others_section, others_table, run_others
    from rig.benchmark.readme import check_readme, write_section
    from rig.cli.fitting import table_console
    from rig.cli.printing import console_table

    if readme is not None:
        check_readme(readme, "others")
    rows = run_others(part or [], Sources(clones, session), say)
    table = others_table(rows)
    table_console(json).print(console_table(table.columns, table.rows, len(table.columns), table.title))
    if readme is not None:
        write_section(readme, "others", others_section(rows))
    if json:
        emit_json(as_json(rows))
    wrong = [row for row in rows if row.met is False]
    for row in wrong:
        say(f"rig: not as expected: {row.part}, {row.what}: {row.result}")
    if wrong:
        raise typer.Exit(Exit.LIMIT_MISSED)
