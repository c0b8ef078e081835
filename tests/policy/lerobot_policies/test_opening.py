"""Folders of LeRobot's other policies: opened as they were saved, refused where they would run or fetch more."""

from __future__ import annotations

import importlib.util
import json
import shutil
import socket
import sys
import textwrap

import pytest
import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.policies import get_policy_class, make_pre_post_processors
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.gaussian_actor.configuration_gaussian_actor import GaussianActorConfig
from lerobot.policies.gaussian_actor.modeling_gaussian_actor import GaussianActorPolicy
from lerobot.policies.tdmpc.configuration_tdmpc import TDMPCConfig
from lerobot.policies.tdmpc.modeling_tdmpc import TDMPCPolicy
from lerobot.policies.vqbet.configuration_vqbet import VQBeTConfig
from lerobot.policies.vqbet.modeling_vqbet import VQBeTPolicy
from safetensors.torch import load_file, save_file

from dualhead_policy.lerobot_policies.chunks import ChunkPolicy
from dualhead_policy.lerobot_policies.offline import FetchError, offline
from dualhead_policy.lerobot_policies.opening import open_lerobot_policy
from dualhead_policy.pretrained import policy_folder

STATE = {
    "observation.state": PolicyFeature(FeatureType.STATE, (2,)),
    "observation.environment_state": PolicyFeature(FeatureType.ENV, (3,)),
}
ACTION = {"action": PolicyFeature(FeatureType.ACTION, (4,))}
SMALL = {"chunk_size": 6, "n_action_steps": 3, "dim_model": 16, "n_heads": 2, "dim_feedforward": 16, "latent_dim": 2}


def saved(policy, folder):
    """A folder as lerobot-train leaves it."""
    features = {**policy.config.input_features, **policy.config.output_features}
    statistics = {
        key: {name: torch.full(feature.shape, value) for name, value in (("mean", 0.5), ("std", 2.0))}
        | {"min": torch.full(feature.shape, -1.0), "max": torch.full(feature.shape, 1.0)}
        for key, feature in features.items()
    }
    for processor in make_pre_post_processors(policy.config, dataset_stats=statistics):
        processor.save_pretrained(folder)
    policy.save_pretrained(folder)
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    config = ACTConfig(input_features=STATE, output_features=ACTION, device="cpu", n_vae_encoder_layers=1, **SMALL)
    return saved(ACTPolicy(config), tmp_path_factory.mktemp("policies") / "act")


@pytest.fixture
def folder(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "act")


def edit(path, change):
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def observed(policy, rows=2):
    generator = torch.Generator().manual_seed(0)
    shapes = policy.observation_shapes
    return {key: torch.rand(rows, policy.n_obs_steps, *shape, generator=generator) for key, shape in shapes.items()}


def test_a_folder_opens_to_the_policy_that_was_saved(whole):
    policy = open_lerobot_policy(whole)
    theirs = ACTPolicy.from_pretrained(whole)
    history = observed(policy)
    pre, post = make_pre_post_processors(theirs.config, pretrained_path=str(whole))
    chunk = post(theirs.predict_action_chunk(pre({key: value[:, 0] for key, value in history.items()})))
    assert torch.allclose(policy.draw(history, 2, seed=0)[:, 1], chunk, atol=1e-6)
    assert (policy.name, policy.action_width, policy.executed_steps, policy.denoising_steps) == ("act", 4, 3, 1)


def test_the_process_keeps_its_own_random_numbers(whole):
    policy = open_lerobot_policy(whole)
    torch.manual_seed(1)
    expected = torch.rand(3)
    torch.manual_seed(1)
    policy.draw(observed(policy), 2, seed=5)
    assert (torch.rand(3) == expected).all()


def test_a_policy_of_images_and_a_past_is_drawn_from(tmp_path):
    features = {"observation.state": STATE["observation.state"]}
    features["observation.image"] = PolicyFeature(FeatureType.VISUAL, (3, 64, 64))
    sizes = {"gpt_n_layer": 1, "gpt_n_head": 2, "gpt_input_dim": 16, "gpt_output_dim": 16, "gpt_hidden_dim": 16}
    config = VQBeTConfig(
        input_features=features, output_features=ACTION, device="cpu", n_obs_steps=3, crop_shape=None,
        pretrained_backbone_weights=None, vqvae_n_embed=4, vqvae_embedding_dim=8, bet_softmax_temperature=5.0, **sizes,
    )  # fmt: skip
    policy = open_lerobot_policy(saved(VQBeTPolicy(config), tmp_path / "vqbet"))
    history = observed(policy)
    chunks = policy.draw(history, 8, seed=0)
    assert chunks.shape == (2, 8, 5, 4)
    assert (chunks == policy.draw(history, 8, seed=0)).all()
    assert not torch.equal(chunks, policy.draw(history, 8, seed=1))
    assert len(chunks[0].unique(dim=0)) > 1


def random_features(width=4):
    """A state and an action of a small robot."""
    return {"input_features": dict(STATE), "output_features": {"action": PolicyFeature(FeatureType.ACTION, (width,))}}


def test_a_plan_of_tdmpc_is_drawn_as_the_policy_executes_it(tmp_path):
    config = TDMPCConfig(
        **random_features(), device="cpu", horizon=6, n_action_repeats=1, n_action_steps=6, mlp_dim=16, latent_dim=8,
        n_gaussian_samples=16, n_pi_samples=4, n_elites=4, cem_iterations=2, state_encoder_hidden_dim=16,
    )  # fmt: skip
    folder = saved(TDMPCPolicy(config), tmp_path / "tdmpc")
    policy = open_lerobot_policy(folder)
    history = observed(policy, rows=1)
    drawn = policy.draw(history, 1, seed=3)[0, 0]
    theirs = TDMPCPolicy.from_pretrained(folder)
    pre, post = make_pre_post_processors(theirs.config, pretrained_path=str(folder))
    theirs.reset()
    torch.manual_seed(3)
    batch = {key: value[:, 0] for key, value in history.items()}
    executed = torch.cat([post(theirs.select_action(pre(batch))) for _ in range(6)])
    assert torch.allclose(drawn, executed, atol=1e-6)
    assert (policy.executed_steps, policy.denoising_steps) == (6, 1)
    assert policy.draw(history, 40, seed=0).unique(dim=1).shape == (1, 40, 6, 4)


def test_a_policy_that_repeats_actions_is_refused(tmp_path):
    config = TDMPCConfig(**random_features(), device="cpu", mlp_dim=16, latent_dim=8, n_action_repeats=2)
    with pytest.raises(ValueError, match="n_action_repeats=2"):
        open_lerobot_policy(saved(TDMPCPolicy(config), tmp_path / "tdmpc"))


def test_a_gaussian_actor_is_a_chunk_of_one_action_and_its_shared_weights_load(tmp_path):
    config = GaussianActorConfig(**random_features(), device="cpu", latent_dim=16)
    folder = saved(GaussianActorPolicy(config), tmp_path / "gaussian")
    policy = open_lerobot_policy(folder)
    theirs = GaussianActorPolicy.from_pretrained(folder).state_dict()
    own = policy.policy.state_dict()
    # The file keeps one name of the encoder that actor and critic share.
    assert len(load_file(folder / "model.safetensors")) < len(own)
    assert own.keys() == theirs.keys()
    assert all(torch.equal(own[name], theirs[name]) for name in own)
    chunks = policy.draw(observed(policy), 5, seed=0)
    assert chunks.shape == (2, 5, 1, 4)
    assert len(chunks[0].unique(dim=0)) == 5


def test_a_shared_tensor_that_is_missing_under_every_name_is_refused(tmp_path):
    config = GaussianActorConfig(**random_features(), device="cpu", latent_dim=16)
    folder = saved(GaussianActorPolicy(config), tmp_path / "gaussian")
    weights = load_file(folder / "model.safetensors")
    shared = next(name for name in weights if "env_encoder.0.weight" in name)
    weights.pop(shared)
    save_file(weights, folder / "model.safetensors")
    with pytest.raises(
        ValueError, match=r"holds other tensors than config\.json describes .*None instead of \[16, 3\]"
    ):
        open_lerobot_policy(folder)


@pytest.mark.parametrize("name", ["somebody/encoder", "./code", "/tmp/code", "https://example.org/a", "a.b"])
def test_a_folder_may_not_choose_what_its_policys_code_opens(tmp_path, name):
    """LeRobot's gaussian actor would load the encoder that the field names, and run code that lies beside it."""
    folder = saved(GaussianActorPolicy(GaussianActorConfig(**random_features(), device="cpu")), tmp_path / "gaussian")
    edit(folder / "config.json", lambda content: content.update(vision_encoder_name=name))
    with pytest.raises(ValueError, match="may not name files or addresses"):
        open_lerobot_policy(folder)


PLUGIN = {
    "__init__": "from lerobot_policy_nodder.configuration_nodder import NodderConfig  # noqa: F401",
    "configuration_nodder": """
        from dataclasses import dataclass, field
        from lerobot.configs import NormalizationMode, PreTrainedConfig
        from lerobot.optim import AdamConfig

        @PreTrainedConfig.register_subclass("nodder")
        @dataclass
        class NodderConfig(PreTrainedConfig):
            chunk_size: int = 8
            n_action_steps: int = 4
            width: int = 16
            normalization_mapping: dict[str, NormalizationMode] = field(
                default_factory=lambda: dict.fromkeys(["STATE", "ENV", "ACTION"], NormalizationMode.MEAN_STD)
            )
            backbone: str = "https://backbones.example.org/default"
            fetches: bool = False
            needs: str = "math"
            observation_delta_indices = action_delta_indices = reward_delta_indices = None

            def get_optimizer_preset(self):
                return AdamConfig()

            def get_scheduler_preset(self):
                return None

            def validate_features(self):
                pass
        """,
    "modeling_nodder": """
        import importlib
        import urllib.request
        import torch
        from lerobot.policies import PreTrainedPolicy
        from lerobot_policy_nodder.configuration_nodder import NodderConfig

        class NodderPolicy(PreTrainedPolicy):
            config_class, name = NodderConfig, "nodder"

            def __init__(self, config, **_):
                super().__init__(config)
                importlib.import_module(config.needs)
                if config.fetches:
                    urllib.request.urlopen(config.backbone)
                inputs = sum(feature.shape[0] for feature in config.input_features.values())
                self.decoder = torch.nn.Linear(inputs, config.chunk_size * config.action_feature.shape[0])

            def predict_action_chunk(self, batch):
                seen = torch.cat([batch[key] for key in self.config.input_features], dim=-1)
                mean = self.decoder(seen).unflatten(-1, (self.config.chunk_size, -1))
                return mean + torch.randn_like(mean)

            def select_action(self, batch):
                return self.predict_action_chunk(batch)[:, 0]

            def forward(self, batch):
                return (self.predict_action_chunk(batch) - batch["action"]).square().mean(), {}

            def get_optim_params(self):
                return self.parameters()

            def reset(self):
                pass
        """,
    "processor_nodder": """
        from lerobot.policies.factory import make_pre_post_processors
        from lerobot.policies.act.processor_act import make_act_pre_post_processors as make_nodder_pre_post_processors
        """,
}


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """An installed distribution of somebody else's, which registers the policy type ``nodder``; its saved policy."""
    site = tmp_path / "site"
    package, metadata = site / "lerobot_policy_nodder", site / "lerobot_policy_nodder-1.0.dist-info"
    package.mkdir(parents=True)
    metadata.mkdir()
    for name, code in PLUGIN.items():
        (package / f"{name}.py").write_text(textwrap.dedent(code))
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: lerobot_policy_nodder\nVersion: 1.0\n")
    monkeypatch.syspath_prepend(site)
    yield site
    for name in [name for name in sys.modules if name.startswith("lerobot_policy_nodder")]:
        del sys.modules[name]
    PreTrainedConfig._choice_registry.pop("nodder", None)


def plugins_policy(folder, **options):
    """A folder with a policy of the plugin's, as another process left it."""
    import lerobot.utils.import_utils as imports

    imports.register_third_party_plugins()
    config = PreTrainedConfig.get_choice_class("nodder")(**random_features(), device="cpu")
    saved(get_policy_class("nodder")(config), folder)
    edit(folder / "config.json", lambda content: content.update(options))
    return folder


def test_a_policy_of_an_installed_plugin_is_opened(plugin, tmp_path):
    folder = plugins_policy(tmp_path / "P")
    # The plugin is found by itself, although nothing has imported it.
    PreTrainedConfig._choice_registry.pop("nodder")
    for name in [name for name in sys.modules if name.startswith("lerobot_policy_nodder")]:
        del sys.modules[name]
    policy = open_lerobot_policy(folder)
    assert (policy.name, policy.executed_steps) == ("nodder", 4)
    chunks = policy.draw(observed(policy), 3, seed=0)
    assert chunks.shape == (2, 3, 8, 4)
    assert len(chunks[0].unique(dim=0)) == 3


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"fetches": True}, r"fetches files from 'backbones\.example\.org' when it is opened.*load it yourself"),
        ({"needs": "no_such_package"}, "lacks a package here .*no_such_package.*install it"),
        ({"backbone": "https://elsewhere.example.org"}, "may not name files or addresses"),
        ({"chunk_size": 9}, "holds other tensors"),
        ({"unknown": 1}, "is no configuration of type 'nodder'"),
    ],
)
def test_a_plugins_policy_that_cannot_be_opened_is_refused_in_a_sentence(plugin, tmp_path, options, sentence):
    folder = plugins_policy(tmp_path / "P", **options)
    with pytest.raises(ValueError, match=sentence) as refusal:
        open_lerobot_policy(folder)
    assert "\n" not in str(refusal.value)


def test_the_guard_lets_everybody_else_connect(plugin, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as server:
        with offline() as attempts, pytest.raises(FetchError), socket.create_connection(server.getsockname()):
            pass
        assert attempts == ["127.0.0.1"]
        with socket.create_connection(server.getsockname()):
            pass


@pytest.mark.parametrize("name", ["eo1", "groot", "pi0", "smolvla", "multi_task_dit", "xvla", "wall_x"])
def test_a_type_whose_packages_are_missing_says_which_to_install(tmp_path, name):
    config = PreTrainedConfig.get_choice_class(name)
    if importlib.util.find_spec("transformers"):
        pytest.skip("transformers is installed")
    folder = tmp_path / name
    folder.mkdir()
    features = {key: {"type": value.type.value, "shape": list(value.shape)} for key, value in STATE.items()}
    action = {"action": {"type": "ACTION", "shape": [4]}}
    (folder / "config.json").write_text(
        json.dumps({"type": config.get_choice_name(config), "input_features": features, "output_features": action})
    )
    save_file({"a": torch.zeros(1)}, folder / "model.safetensors")
    with pytest.raises(ValueError, match=r"pip install|No module named") as refusal:
        open_lerobot_policy(folder)
    assert "\n" not in str(refusal.value)


def test_a_type_that_nothing_registers_is_refused(folder):
    edit(folder / "config.json", lambda content: content.update(type="sombody_elses"))
    with pytest.raises(ValueError, match=r"which no installed package registers \(known: act, .*install the plugin"):
        open_lerobot_policy(folder)


def test_a_policy_that_averages_chunks_is_refused(whole):
    config = ACTConfig(
        input_features=STATE, output_features=ACTION, device="cpu", n_vae_encoder_layers=1,
        **(SMALL | {"n_action_steps": 1}), temporal_ensemble_coeff=0.01,
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"temporal_ensemble_coeff=0\.01"):
        ChunkPolicy(ACTPolicy(config), dict, dict)


def test_a_repository_on_the_hub_is_found_in_the_downloads(whole, tmp_path, monkeypatch):
    # The cache as huggingface_hub leaves it; offline, the name resolves there.
    repository = tmp_path / "hub" / "models--somebody--act"
    snapshot = repository / "snapshots" / "0123456789abcdef0123456789abcdef01234567"
    shutil.copytree(whole, snapshot)
    (repository / "refs").mkdir()
    (repository / "refs" / "main").write_text(snapshot.name)
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    found = policy_folder("somebody/act")
    assert found == snapshot
    assert open_lerobot_policy(found).name == "act"
    with pytest.raises(FileNotFoundError, match="neither a folder here nor a policy on the hub"):
        policy_folder("somebody/else")


@pytest.mark.parametrize(
    "step",
    [
        {"class": "subprocess.Popen", "config": {"args": ["touch", "it-ran"]}},
        {"registry_name": "normalizer_processor", "class": "os.system", "config": {"command": "touch it-ran"}},
        {"registry_name": "tokenizer_processor", "config": {"tokenizer_name": "somebody/code"}},
        {"registry_name": "reward_classifier_processor", "config": {"pretrained_path": "/"}},
    ],
)
def test_a_step_that_could_run_or_fetch_anything_is_refused(folder, tmp_path, monkeypatch, step):
    monkeypatch.chdir(tmp_path)
    edit(folder / "policy_preprocessor.json", lambda content: content["steps"].append(step))
    with pytest.raises(ValueError, match="policy_preprocessor"):
        open_lerobot_policy(folder)
    assert not (tmp_path / "it-ran").exists()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("type", "groot"),
        ("type", 3),
        ("dim_model", 10**9),
        ("dim_model", 8192),  # no allocation either: the weights are of another size
        ("n_encoder_layers", 10**6),
        ("dim_model", "sixteen"),
        ("stranger", 1),
        ("use_peft", True),
        ("input_features", {"observation.state": {"type": "STATE", "shape": [10**9]}}),
        ("output_features", {}),
        ("n_heads", 3),
    ],
)
def test_a_configuration_that_is_none_or_of_other_weights_is_refused(folder, field, value):
    edit(folder / "config.json", lambda content: content.update({field: value}))
    with pytest.raises(ValueError, match=r"config\.json|model\.safetensors") as refusal:
        open_lerobot_policy(folder)
    assert str(refusal.value).isprintable()


def test_weights_that_are_damaged_or_not_finite_are_refused(folder):
    weights = load_file(folder / "model.safetensors")
    name = "model.action_head.weight"
    save_file(weights | {name: torch.full_like(weights[name], torch.nan)}, folder / "model.safetensors")
    with pytest.raises(ValueError, match="has non-finite tensors"):
        open_lerobot_policy(folder)
    (folder / "model.safetensors").write_bytes((folder / "model.safetensors").read_bytes()[:1000])
    with pytest.raises(ValueError, match="may be truncated"):
        open_lerobot_policy(folder)


def test_statistics_that_are_not_finite_and_links_out_of_the_folder_are_refused(folder, tmp_path):
    file = next(folder.glob("policy_preprocessor*normalizer*.safetensors"))
    state = load_file(file)
    state["observation.state.mean"][0] = torch.inf
    save_file(state, file)
    with pytest.raises(ValueError, match="not finite"):
        open_lerobot_policy(folder)
    (tmp_path / "elsewhere").write_bytes(file.read_bytes())
    file.unlink()
    file.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match="link that leaves its folder"):
        open_lerobot_policy(folder)


def test_normalisation_is_the_folders_own(whole):
    """ACT's default maps actions by mean and deviation; the postprocessor brings them back."""
    policy = open_lerobot_policy(whole)
    assert policy.policy.config.normalization_mapping["ACTION"] is NormalizationMode.MEAN_STD
    assert torch.allclose(policy.postprocess(torch.zeros(1, 4)), torch.full((1, 4), 0.5))
