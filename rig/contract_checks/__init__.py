"""The contract of every arm, gripper, sensor, camera and estimator, as tests that any lab can run.

    python -m pytest -p rig.contract_checks.options --pyargs rig.contract_checks OPTIONS

with `--estimator my_lab.rotation:MyEstimator`, or with `--bench my_bench.toml`, and `--moves` if a person is
at the bench. The rig's own classes are tested with the same checks. No other package of the rig imports this
one, pytest or hypothesis; both are installed with the rig so that the checks run anywhere.
"""
