"""`rig benchmark others`: others' clients, data and solvers beside ours."""

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.benchmark.tables import ReadmeOption
from rig.cli.common import Exit, JsonOption, emit_json, say
from rig.cli.places import folder_place


def others(
    part: Annotated[
        list[str] | None,
        typer.Option(
            "--part", help="clients, kinhec, boards, streams, recordings or files; repeat. Default: all."
        ),
    ] = None,
    clones: Annotated[
        Path | None,
        typer.Option("--clones", help="Folder with clones of public repositories, as OWNER/NAME."),
    ] = None,
    session: Annotated[
        Path | None, typer.Option("--session", help="A session of rig trial, whose files are opened.")
    ] = None,
    kinhec: Annotated[
        Path,
        typer.Option("--kinhec", help="Folder of kinhec's sequences; made once.", callback=folder_place),
    ] = Path("kinhec-smoke"),
    readme: ReadmeOption = None,
    json: JsonOption = False,
) -> None:
    """Run what others made against what was made here: clients, data sets, solvers, readers of files.

    Each part needs something that does not come with the rig, packages or clones, and is skipped, saying
    how to get it, where that is not here. Nothing leaves loopback. See docs/others.md. Exit code 4 where
    something did not come out as it should.

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
    rows = run_others(part or [], Sources(clones, session, kinhec), say)
    table = others_table(rows)
    table_console(json).print(console_table(table.columns, table.rows, len(table.columns), table.title))
    if readme is not None:
        write_section(readme, "others", others_section(rows))
    if json:
        emit_json(as_json(rows))
    wrong = [row for row in rows if row.met is False]
    for row in wrong:
        say(f"rig: not as it should be: {row.part}, {row.what}: {row.result}")
    if wrong:
        raise typer.Exit(Exit.LIMIT_MISSED)
