"""Scene and model files in YAML, found by path or by the name of a scene that comes with the package."""

from pathlib import Path
from typing import Any

from synthcam_shared import settings
from synthcam_shared.errors import InputError as InputError

SCENES = Path(__file__).with_name("scenes")


def read_yaml(path: Path) -> dict[str, Any]:
    """Keys and values of a scene or model file. Raises InputError where it cannot be read or is not plain YAML.

    A path NAME or scenes/NAME.yaml that does not exist means the scene of that name in the package.
    """
    packaged = SCENES / f"{path.name.removesuffix('.yaml')}.yaml"
    is_name = path.parent == Path("scenes") or path == Path(path.stem)
    return settings.read_yaml(packaged if is_name and not path.exists() and packaged.is_file() else path)
