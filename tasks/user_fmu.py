"""An FMU that a configuration file names, with what is observed, applied and minimised."""

import hashlib
from pathlib import Path
from typing import Any

from zoac.config.named_code import locate_code
from zoac.core.errors import ConfigError
from zoac.envs.fmu import FmuEnv
from zoac.envs.fmu_instance import description


class FmuFile:
    """An FMU and how it is stepped, as a configuration file names them; makes environments."""

    def __init__(self, path: str, **options: Any) -> None:
        """
        Args:
            path: Of the `.fmu` file.
            options: All of `FmuEnv`, those that are not given as None; a `cost` that is no variable
                is the dotted path of a function.

        Raises:
            ConfigError: If the file cannot be used here, or an option is missing or wrong.
        """
        missing = [name for name, value in options.items() if value is None]
        if missing:
            raise ConfigError(
                f"env={path!r}: an FMU needs {', '.join(missing)} too; in Python give "
                "env=lambda: zoac.envs.FmuEnv(...)"
            )
        file, cost = Path(path).expanduser(), options["cost"]
        known = {v.name for v in description(file).modelVariables}
        if isinstance(cost, str) and cost not in known and "." in cost:
            wanted = "a variable of the FMU, or a function of {name: value}"
            options["cost"] = locate_code(cost, "cost", (), (float,), wanted)
        self.path, self.options = path, options
        # Another model under the same name is another environment.
        self.digest = hashlib.sha256(file.read_bytes()).hexdigest()
        self().close()  # says what is wrong with an option

    def __call__(self) -> FmuEnv:
        """Return an environment."""
        return FmuEnv(self.path, **self.options)
