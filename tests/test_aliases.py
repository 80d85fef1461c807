"""Names of the release before resolve to their new homes, with a deprecation warning."""

import pytest

import navrl.build
from navrl import factory, jobs


@pytest.mark.parametrize(
    "old, new",
    [
        ("make_env", factory.make_env),
        ("run_evaluation", jobs.run_evaluation),
        ("Contender", factory.EvaluatedPolicy),
        ("make_contender", factory.make_evaluated_policy),
    ],
)
def test_old_build_names_warn_and_resolve(old, new):
    with pytest.warns(DeprecationWarning, match=f"navrl.build.{old} is deprecated"):
        assert getattr(navrl.build, old) is new


def test_unknown_build_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = navrl.build.no_such_name
