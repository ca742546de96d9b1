"""Polygons of WKT and GeoJSON files, in metres: holes, several polygons, any orientation.

A WKT file has one geometry. A GeoJSON file has a geometry, a feature or a collection of them.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ...checks import short_repr
from ...limits import LARGEST
from .grid import Area, Pose

_SURFACES = ("Polygon", "MultiPolygon")


def read(path: Path) -> Area:
    """Union of the polygons of a file."""
    import shapely

    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a text file; save it as UTF-8") from error
    is_wkt = path.suffix.lower() == ".wkt"
    geometries = _of_wkt(path, text) if is_wkt else _of_geojson(path, text)
    surfaces = []
    for place, geometry in geometries:
        for part in shapely.get_parts(geometry):
            surfaces.append(_checked(f"{path}: {place}", part))
    union = shapely.union_all(surfaces)
    if union.is_empty:
        raise ValueError(f"{path}: has no polygon; give at least one")
    return Area(union, tuple(union.bounds), Pose(), bordered=False)


def _checked(place: str, geometry: Any) -> Any:
    """A valid polygon of the plane."""
    import shapely

    if geometry.geom_type == "GeometryCollection":
        parts = [_checked(f"{place}, part {k}", one) for k, one in enumerate(geometry.geoms)]
        return shapely.union_all(parts)
    if geometry.geom_type not in _SURFACES:
        raise ValueError(f"{place} is a {geometry.geom_type}; it must be a Polygon; buffer lines")
    flat = shapely.force_2d(geometry)
    coordinates = shapely.get_coordinates(flat)
    if not (abs(coordinates) <= LARGEST).all():
        raise ValueError(f"{place}: a coordinate is not finite, or beyond {LARGEST:g} m")
    if not flat.is_valid:
        why = shapely.is_valid_reason(flat)
        raise ValueError(f"{place} is not valid: {why}; repair it with shapely.make_valid")
    return flat


def _of_wkt(path: Path, text: str) -> Iterator[tuple[str, Any]]:
    import shapely

    try:
        yield "geometry", shapely.from_wkt(text.strip())
    except shapely.GEOSException as error:
        raise ValueError(f"{path}: not WKT: {short_repr(str(error))[1:-1]}") from error


def _of_geojson(path: Path, text: str) -> Iterator[tuple[str, Any]]:
    try:
        content = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: not JSON: {short_repr(str(error))[1:-1]}") from error
    if not isinstance(content, Mapping) or "type" not in content:
        raise ValueError(f"{path}: not GeoJSON; it must be an object with a type")
    if content["type"] != "FeatureCollection":
        yield _of_feature(path, "geometry", content)
        return
    features = content.get("features")
    if not isinstance(features, list):
        raise ValueError(f"{path}: features are {short_repr(features)}; they must be a list")
    for k, feature in enumerate(features):
        yield _of_feature(path, f"feature {k}", feature)


def _of_feature(path: Path, place: str, feature: Any) -> tuple[str, Any]:
    from shapely.geometry import shape

    geometry = feature
    if isinstance(feature, Mapping) and feature.get("type") == "Feature":
        geometry = feature.get("geometry")
    if not isinstance(geometry, Mapping):
        raise ValueError(f"{path}: {place} is {short_repr(geometry)}; it must be a geometry")
    try:
        return place, shape(geometry)
    except Exception as error:  # shapely raises errors of many types
        found = short_repr(dict(geometry))
        raise ValueError(f"{path}: {place} is {found}; it must be a GeoJSON polygon") from error
