"""What every writer of attitude series gives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import TracebackType
    from typing import Any, Self

    from quatprop.series import AttitudeSeries


class AttitudeWriter(ABC):
    """Takes batches of attitudes in order; what is not committed leaves no trace."""

    @abstractmethod
    def write(self, series: AttitudeSeries) -> None:
        """Append a batch.

        Raises
        ------
        OutputError
            The disk is full, or the target is otherwise gone.
        BrokenPipeError
            Whoever read the output has gone.
        """

    @abstractmethod
    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Finish the file and put it in its place.

        Parameters
        ----------
        provenance
            How the attitudes came about: convention, layout, method, q0, source, counts,
            versions; JSON-ready. Kept in the file where the format has room for it.

        Raises
        ------
        OutputError
            The file cannot be finished.
        """

    @abstractmethod
    def abort(self) -> None:
        """Remove what was not committed; harmless after a commit."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.abort()
