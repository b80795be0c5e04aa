"""The paper's Tables III and IV on the same simulated lifts."""
