"""A progress bar for runs: step, time, iterations per step and energy; nothing when it is off."""


class Progress:
    """A context that shows how a run advances when `enabled` (a tqdm bar on standard error).

    The run is done when its time has advanced by `duration`, or after `steps` steps where that is given.
    """

    def __init__(self, duration: float | None = None, enabled: bool = True, steps: int | None = None):
        self.duration, self.enabled, self.steps, self.bar = duration, enabled, steps, None
        self.taken, self.start = 0, 0.0

    def __enter__(self):
        if self.enabled:
            from tqdm.auto import tqdm

            self.bar = tqdm(
                total=100,
                desc="compiling",
                bar_format="{desc}{percentage:3.0f}% |{bar}| [{elapsed}<{remaining}{postfix}]",
            )
        return self

    def __exit__(self, *_):
        if self.bar is not None:
            self.bar.close()

    def advance(self, record) -> None:
        """Show the steps that were just finished; `record` holds their times, iterations and energies."""
        if self.bar is None or record.time.size == 0:
            return
        energy = record.observed.kinetic[-1] + record.observed.strain[-1]
        self.taken += record.time.size
        passed = float(record.time[-1] - self.start)
        part = passed / self.duration if self.duration else self.taken / (self.steps or 1)
        self.bar.set_description("running", refresh=False)
        self.bar.set_postfix_str(
            f"step {self.taken}, t = {record.time[-1]:.4g}, {record.iterations.mean():.1f} iterations/step, "
            f"energy {energy:.6g}",
            refresh=False,
        )
        self.bar.update(min(100.0 * part, 100.0) - self.bar.n)
