"""What every arm, gripper, sensor, camera and estimator must do, as tests that anybody runs on a class.

    python -m pytest -p rig.contract_checks.options --pyargs rig.contract_checks OPTIONS

with `--estimator my_lab.rotation:MyEstimator`, or with `--bench my_bench.toml` and `--moves` once somebody
stands at the bench. The rig's own are held to the same ones. No other package of the rig imports this one,
pytest or hypothesis, which are installed with the rig so that the checks run anywhere.
"""
