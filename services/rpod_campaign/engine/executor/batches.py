"""Batches of the remaining trials, of about a second each, for the workers of a cluster."""

from collections import Counter, deque
from collections.abc import Iterable

from rpod_campaign.engine.executor.port import Task

_BATCH_S = 1.0
"""Approximate duration of a batch, s: much more than its transfer takes, and little to run again."""
_MOST = 500
"""Largest number of trials in a batch."""
_SHARES = 4
"""Least number of batches for each worker's share of the remaining trials, so that all workers end
together."""

Batch = tuple[Task, ...]
"""Trials of one cell."""


class Batches:
    """The remaining trials as batches, and a count of the workers that ended while they ran a trial."""

    def __init__(self, tasks: Iterable[Task]) -> None:
        self._waiting = deque(tasks)
        self._alone: deque[Task] = deque()
        """Trials whose worker ended; they run one by one, so that the cause is known."""
        self._unfinished = set(self._waiting)
        self._trial_s: dict[int, float] = {}
        """Time of a trial, s, by cell."""
        self._ended: Counter[Task] = Counter()

    @property
    def left(self) -> int:
        """Number of trials that are not finished."""
        return len(self._unfinished)

    def take(self, workers: int, *, idle: bool = True) -> Batch:
        """Return the next batch, empty if all trials are running.

        Args:
            workers: number of workers that share the remaining trials.
            idle: whether the worker has no other batch. A trial whose worker ended is given to an idle worker
                only: a batch that ends its worker may take the answer of the one before with it.
        """
        while idle and self._alone:
            task = self._alone.popleft()
            if task in self._unfinished:
                return (task,)
        taken: list[Task] = []
        while self._waiting and len(taken) < self._size(workers, taken):
            if taken and self._waiting[0].cell != taken[0].cell:
                break
            task = self._waiting.popleft()
            if task in self._unfinished and task not in taken:
                taken.append(task)
        return tuple(taken)

    def runs_alone(self, batch: Batch) -> bool:
        """Return whether no other batch may wait behind this one, since a worker ended while it ran."""
        return any(task in self._ended for task in batch)

    def give_back(self, batch: Batch) -> None:
        """Put back a batch that was not run."""
        self._waiting.extendleft(reversed(batch))

    def share(self, batch: Batch) -> None:
        """Put a batch that may still be running behind all others, so that another worker runs it too."""
        self._waiting.extend(batch)

    def put_all_back(self) -> None:
        """Put back all trials that are not finished, wherever they were."""
        left = sorted(self._unfinished)
        self._alone = deque(task for task in left if task in self._ended)
        self._waiting = deque(task for task in left if task not in self._ended)

    def worker_ended(self, batch: Batch) -> tuple[Task, int]:
        """Put back a batch whose worker ended; return its trial with most ended workers, and their count."""
        self._alone.extend(batch)
        self._ended.update(batch)
        return max(((task, self._ended[task]) for task in batch), key=lambda pair: pair[1])

    def finish(self, batch: Batch, done: Iterable[int], took_s: float) -> tuple[int, ...]:
        """Return the numbers of the trials that are finished for the first time.

        Args:
            batch: the batch that came back.
            done: numbers of its finished trials.
            took_s: time of the whole batch, s.
        """
        finished = [Task(batch[0].cell, number) for number in done]
        new = tuple(task.trial for task in finished if task in self._unfinished)
        self._unfinished.difference_update(finished)
        if finished:
            each_s, cell = took_s / len(finished), batch[0].cell
            self._trial_s[cell] = 0.5 * (self._trial_s.get(cell, each_s) + each_s)
        return new

    def _size(self, workers: int, taken: list[Task]) -> int:
        cell = (taken or self._waiting)[0].cell
        if cell not in self._trial_s:
            return 1
        fair = self.left // (_SHARES * max(workers, 1))
        return max(1, min(_MOST, fair, int(_BATCH_S / max(self._trial_s[cell], 1e-6))))
