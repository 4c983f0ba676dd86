"""Network, flow and contacts: what the pore space conducts and what the grains lean on."""


rule network:
    input:
        volume=f"{TWIN}/twin.zarr.zip",
    output:
        pores=f"{TWIN}/network_pores.csv",
        throats=f"{TWIN}/network_throats.csv",
        record=f"{TWIN}/logs/network.json",
    log:
        f"{TWIN}/logs/network.log",
    benchmark:
        f"{TWIN}/benchmarks/network.tsv"
    cache: CACHEABLE
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(6000),
        runtime=runtime(60),
    params:
        settings=settings("network"),
        science=science("network", "volume"),
    script:
        "../../scripts/network.py"


use rule network as reference_network with:
    input:
        volume=f"{SAMPLE}/reference.zarr.zip",
    output:
        pores=f"{SAMPLE}/reference_network_pores.csv",
        throats=f"{SAMPLE}/reference_network_throats.csv",
        record=f"{SAMPLE}/logs/reference_network.json",
    log:
        f"{SAMPLE}/logs/reference_network.log",
    benchmark:
        f"{SAMPLE}/benchmarks/reference_network.tsv"
    wildcard_constraints:
        sample=any_of(MEASURED),


rule flow:
    input:
        volume=f"{TWIN}/twin.zarr.zip",
        pores=f"{TWIN}/network_pores.csv",
        throats=f"{TWIN}/network_throats.csv",
    output:
        flow=f"{TWIN}/flow.csv",
    log:
        f"{TWIN}/logs/flow.log",
    benchmark:
        f"{TWIN}/benchmarks/flow.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(8000),
        runtime=runtime(120),
    params:
        settings=settings("network", "flow"),
        science=science("flow", "volume"),
    script:
        "../../scripts/flow.py"


use rule flow as reference_flow with:
    input:
        volume=f"{SAMPLE}/reference.zarr.zip",
        pores=f"{SAMPLE}/reference_network_pores.csv",
        throats=f"{SAMPLE}/reference_network_throats.csv",
    output:
        flow=f"{SAMPLE}/reference_flow.csv",
    log:
        f"{SAMPLE}/logs/reference_flow.log",
    benchmark:
        f"{SAMPLE}/benchmarks/reference_flow.tsv"
    wildcard_constraints:
        sample=any_of(MEASURED),


rule contacts:
    input:
        library=f"{SAMPLE}/grains3d",
        packed=f"{TWIN}/second/bodies.csv",
        forces=f"{TWIN}/second/forces.csv",
        bodies=f"{TWIN}/bodies.csv",
        twin=f"{TWIN}/twin.zarr.zip",
    output:
        contacts=f"{TWIN}/contacts.csv",
        summary=f"{TWIN}/contacts.json",
    log:
        f"{TWIN}/logs/contacts.log",
    benchmark:
        f"{TWIN}/benchmarks/contacts.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(3000),
        runtime=runtime(60),
    params:
        settings=settings("contacts", "packing", "effects"),
        science=science("contacts"),
    script:
        "../../scripts/contacts.py"


rule resettling:
    input:
        scene=f"{VARIANT}/scene.json",
        library=f"{SAMPLE}/grains3d",
        packed=f"{TWIN}/second/bodies.csv",
    output:
        change=f"{TWIN}/resettling.json",
    log:
        f"{TWIN}/logs/resettling.log",
    benchmark:
        f"{TWIN}/benchmarks/resettling.tsv"
    conda:
        ENVS["packing"]
    resources:
        mem_mb=memory(4000),
        runtime=runtime(120),
    params:
        settings=settings("packing", "effects"),
        science=science("packing", "volume", "correlation"),
    script:
        "../../scripts/resettling.py"
