"""Calibration: parameters of scenes from measured targets, by Optuna; any number of workers, restartable."""
