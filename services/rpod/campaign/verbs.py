"""``rpod campaign NAME``: one verb for each campaign, generated from the campaign's model of options."""

import inspect
from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin

import typer
from typer.core import TyperGroup

if TYPE_CHECKING:
    from rpod_campaign.engine.options import Options

_EVERYWHERE = {
    "out": Annotated[
        Path, typer.Option("--out", help="Folder in which the campaign's own folder is created.")
    ],
    "jobs": Annotated[
        int | None,
        typer.Option("--jobs", help="Number of processes on this machine; one for each core if not given."),
    ],
    "cluster": Annotated[
        str | None,
        typer.Option(
            "--cluster",
            metavar="ADDRESS",
            help="Run the trials on the workers of a Dask scheduler, such as tcp://host:8786, or of local:N.",
        ),
    ],
    "as_json": Annotated[
        bool,
        typer.Option(
            "--json",
            help="Print the cells as one JSON object; progress on standard error, a line a minute at most.",
        ),
    ],
}
_DEFAULTS: dict[str, Any] = {"out": Path("campaigns"), "jobs": None, "cluster": None, "as_json": False}


class CampaignGroup(TyperGroup):
    """Finds a campaign in the catalogue when its verb is used."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all campaigns."""
        from rpod_campaign.catalogue import names

        return [*super().list_commands(ctx), *names()]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a campaign's verb; None if no campaign has the name."""
        from rpod_campaign.catalogue import RENAMED, names, options_of

        if cmd_name in RENAMED:
            typer.echo(f"{cmd_name} is called {RENAMED[cmd_name]} now", err=True)
            cmd_name = RENAMED[cmd_name]
        if cmd_name not in names():
            meant = get_close_matches(cmd_name, names(), n=1)
            if meant and cmd_name not in self.commands:
                ctx.fail(f"No such command {cmd_name!r}. Did you mean {meant[0]!r}?")
            return super().get_command(ctx, cmd_name)
        return _verb(cmd_name, options_of(cmd_name))


campaign_verbs = typer.Typer(
    name="campaign",
    cls=CampaignGroup,
    no_args_is_help=True,
    rich_markup_mode=None,
)


@campaign_verbs.callback()
def campaign() -> None:
    """Run Monte-Carlo trials of the methods. Tables show the figures of the papers beside them."""


def _verb(name: str, model: "type[Options]") -> Any:
    """Return the command of a campaign."""

    def run(**given: Any) -> None:
        from rpod.campaign.command import campaign_command

        common = {key: given.pop(key) for key in _EVERYWHERE}
        raise typer.Exit(campaign_command(name, options=given, **common))

    _declare(run, _parameters(model))
    single = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    single.command(name=name, help=f"{model.title}.")(run)
    return typer.main.get_command(single)


def _parameters(model: "type[Options]") -> dict[str, tuple[Any, Any]]:
    """Return annotation and default of each parameter of the command line, by name."""
    from rpod_campaign.engine.options import Provided

    options = {
        name: (Annotated[str | None, _option(name, field)], None)
        for name, field in model.model_fields.items()
        if not any(isinstance(mark, Provided) for mark in field.metadata)
    }
    return options | {name: (_EVERYWHERE[name], default) for name, default in _DEFAULTS.items()}


def _option(name: str, field: Any) -> Any:
    default = field.get_default(call_default_factory=True)
    shown = "" if default is None or default == () else f"  [default: {_shown(default)}]"
    return typer.Option(
        f"--{name.replace('_', '-')}", help=f"{field.description}{shown}", metavar=_metavar(field.annotation)
    )


def _metavar(annotation: Any) -> str:
    """Return the placeholder of an option's value in the help."""
    from rpod_campaign.engine.options import choices

    named = choices(annotation)
    if named:
        one = "|".join(named)
    else:
        kinds = _kinds(annotation)
        one = "INTEGER" if int in kinds else "NUMBER" if float in kinds else "NAME"
    return f"{one},..." if _is_list(annotation) else one


def _kinds(annotation: Any) -> set[Any]:
    inner = get_args(annotation)
    return set().union(*map(_kinds, inner)) if inner else {annotation}


def _is_list(annotation: Any) -> bool:
    return get_origin(annotation) is tuple or any(_is_list(inner) for inner in get_args(annotation))


def _shown(default: Any) -> str:
    """Return a default value in the form of the command line."""
    if isinstance(default, tuple):
        return ",".join(map(_shown, default))
    return f"{default:g}" if isinstance(default, float) else str(default)


def _declare(function: Callable[..., None], parameters: dict[str, tuple[Any, Any]]) -> None:
    """Set the parameters of a function, which typer reads."""
    function.__annotations__ = {name: annotation for name, (annotation, _) in parameters.items()}
    signature = inspect.Signature(
        [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
            for name, (annotation, default) in parameters.items()
        ]
    )
    function.__signature__ = signature  # type: ignore[attr-defined]
