"""Policy files: those of a run, and those that come with the package."""
