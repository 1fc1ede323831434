"""Experiments with air_ground: dataset conversion, bag checks, replay reports."""
