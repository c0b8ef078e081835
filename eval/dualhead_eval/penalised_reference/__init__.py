"""The population optimum of flow matching with endpoint consistency, solved numerically.

Beside the exact reference, which is the optimum without consistency: ``two_mode_pair`` says what is sampled,
``conditional_expectation`` how one head sees the other, ``optimum`` derives and solves the equations, ``ring`` and
``robot`` put the solution behind the policy's sampling interface.
"""
