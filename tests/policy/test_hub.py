"""The real upload to a hub; needs an account, so it runs only on request.

    HF_TOKEN=... DUALHEAD_HUB_ACCOUNT=me uv run pytest -m hub

creates a private repository, loads the policy from it, and deletes it again.
"""

from __future__ import annotations

import os
import uuid

import pytest
import torch
from huggingface_hub import HfApi

from dualhead_policy import DualheadPolicy
from dualhead_policy.pretrained import load_policy, policy_folder

ACCOUNT = "DUALHEAD_HUB_ACCOUNT"


@pytest.mark.hub
def test_a_pushed_policy_comes_back_from_the_hub(trained, tmp_path):
    account = os.environ.get(ACCOUNT)
    assert account, f"set {ACCOUNT} to the account whose token may create and delete repositories"
    repository = f"{account}/dualhead-test-{uuid.uuid4().hex[:8]}"
    policy, _ = load_policy(trained)
    api = HfApi()
    try:
        policy.push_to_hub(repository, private=True)
        ours = {path.name for path in policy_folder(trained).iterdir() if not path.name.startswith("policy_")}
        assert ours - {"train_config.json"} <= set(api.list_repo_files(repository))
        loaded = DualheadPolicy.from_pretrained(repository, cache_dir=tmp_path)
    finally:
        api.delete_repo(repository, missing_ok=True)
    assert all(torch.equal(a, b) for a, b in zip(policy.parameters(), loaded.parameters(), strict=True))
