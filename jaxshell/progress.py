"""A progress bar for runs: step, time, iterations per step and energy; nothing when it is off."""


class Progress:
    """A context that shows how a run advances when `enabled` (a tqdm bar on standard error)."""

    def __init__(self, steps: int, enabled: bool):
        self.steps, self.enabled, self.bar = steps, enabled, None

    def __enter__(self):
        if self.enabled:
            from tqdm.auto import tqdm

            self.bar = tqdm(total=self.steps, unit="step", desc="compiling")
        return self

    def __exit__(self, *_):
        if self.bar is not None:
            self.bar.close()

    def advance(self, record) -> None:
        """Show the steps that were just finished; `record` holds their times, iterations and energies."""
        if self.bar is None or record.time.size == 0:
            return
        energy = record.observed.kinetic[-1] + record.observed.strain[-1]
        self.bar.set_description("running", refresh=False)
        self.bar.set_postfix_str(
            f"t = {record.time[-1]:.4g}, {record.iterations.mean():.1f} iterations/step, energy {energy:.6g}"
        )
        self.bar.update(record.time.size)
