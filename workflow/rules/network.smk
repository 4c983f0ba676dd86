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
    threads: many_threads
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


if SLABS > 1:

    ruleorder: network_joined > network
    ruleorder: reference_network_joined > reference_network

    rule network_slab_columns:
        input:
            volume=f"{TWIN}/twin.zarr.zip",
        output:
            columns=temp(f"{TWIN}/slabs/network_columns_{{scatteritem}}.npz"),
        log:
            f"{TWIN}/logs/network_columns_{{scatteritem}}.log",
        benchmark:
            f"{TWIN}/benchmarks/network_columns_{{scatteritem}}.tsv"
        conda:
            ENVS["analysis"]
        resources:
            mem_mb=memory(6000),
            runtime=runtime(60),
        params:
            settings=settings("network"),
            science=science("network", "volume"),
        script:
            "../../scripts/network_columns.py"

    use rule network_slab_columns as reference_network_slab_columns with:
        input:
            volume=f"{SAMPLE}/reference.zarr.zip",
        output:
            columns=temp(f"{SAMPLE}/reference_network_columns_{{scatteritem}}.npz"),
        log:
            f"{SAMPLE}/logs/reference_network_columns_{{scatteritem}}.log",
        benchmark:
            f"{SAMPLE}/benchmarks/reference_network_columns_{{scatteritem}}.tsv"
        wildcard_constraints:
            sample=any_of(MEASURED),

    rule network_slab_distances:
        input:
            volume=f"{TWIN}/twin.zarr.zip",
            columns=gather.grainfall_slabs(
                f"{TWIN}/slabs/network_columns_{{scatteritem}}.npz", allow_missing=True
            ),
        output:
            distances=temp(f"{TWIN}/slabs/network_distances_{{scatteritem}}.npz"),
        log:
            f"{TWIN}/logs/network_distances_{{scatteritem}}.log",
        benchmark:
            f"{TWIN}/benchmarks/network_distances_{{scatteritem}}.tsv"
        conda:
            ENVS["analysis"]
        resources:
            mem_mb=memory(6000),
            runtime=runtime(60),
        params:
            settings=settings("network"),
            science=science("network", "volume"),
        script:
            "../../scripts/network_distances.py"

    use rule network_slab_distances as reference_network_slab_distances with:
        input:
            volume=f"{SAMPLE}/reference.zarr.zip",
            columns=gather.grainfall_slabs(
                f"{SAMPLE}/reference_network_columns_{{scatteritem}}.npz",
                allow_missing=True,
            ),
        output:
            distances=temp(f"{SAMPLE}/reference_network_distances_{{scatteritem}}.npz"),
        log:
            f"{SAMPLE}/logs/reference_network_distances_{{scatteritem}}.log",
        benchmark:
            f"{SAMPLE}/benchmarks/reference_network_distances_{{scatteritem}}.tsv"
        wildcard_constraints:
            sample=any_of(MEASURED),

    rule network_slab_basins:
        input:
            distances=beside(f"{TWIN}/slabs/network_distances_{{scatteritem}}.npz"),
        output:
            field=temp(f"{TWIN}/slabs/network_basins_{{scatteritem}}.npz"),
            graph=temp(f"{TWIN}/slabs/network_basins_graph_{{scatteritem}}.npz"),
        log:
            f"{TWIN}/logs/network_basins_{{scatteritem}}.log",
        benchmark:
            f"{TWIN}/benchmarks/network_basins_{{scatteritem}}.tsv"
        conda:
            ENVS["analysis"]
        resources:
            mem_mb=memory(6000),
            runtime=runtime(60),
        params:
            science=science("network", "volume"),
        script:
            "../../scripts/network_basins.py"

    use rule network_slab_basins as reference_network_slab_basins with:
        input:
            distances=beside(
                f"{SAMPLE}/reference_network_distances_{{scatteritem}}.npz"
            ),
        output:
            field=temp(f"{SAMPLE}/reference_network_basins_{{scatteritem}}.npz"),
            graph=temp(f"{SAMPLE}/reference_network_basins_graph_{{scatteritem}}.npz"),
        log:
            f"{SAMPLE}/logs/reference_network_basins_{{scatteritem}}.log",
        benchmark:
            f"{SAMPLE}/benchmarks/reference_network_basins_{{scatteritem}}.tsv"
        wildcard_constraints:
            sample=any_of(MEASURED),

    rule network_pores:
        input:
            graphs=gather.grainfall_slabs(
                f"{TWIN}/slabs/network_basins_graph_{{scatteritem}}.npz",
                allow_missing=True,
            ),
        output:
            pores=temp(
                scatter.grainfall_slabs(
                    f"{TWIN}/slabs/network_pores_{{scatteritem}}.npz",
                    allow_missing=True,
                )
            ),
        log:
            f"{TWIN}/logs/network_pores.log",
        benchmark:
            f"{TWIN}/benchmarks/network_pores.tsv"
        conda:
            ENVS["analysis"]
        resources:
            mem_mb=memory(4000),
            runtime=runtime(30),
        params:
            settings=settings("network"),
            science=science("network", "volume"),
        script:
            "../../scripts/network_pores.py"

    use rule network_pores as reference_network_pores with:
        input:
            graphs=gather.grainfall_slabs(
                f"{SAMPLE}/reference_network_basins_graph_{{scatteritem}}.npz",
                allow_missing=True,
            ),
        output:
            pores=temp(
                scatter.grainfall_slabs(
                    f"{SAMPLE}/reference_network_pores_{{scatteritem}}.npz",
                    allow_missing=True,
                )
            ),
        log:
            f"{SAMPLE}/logs/reference_network_pores.log",
        benchmark:
            f"{SAMPLE}/benchmarks/reference_network_pores.tsv"
        wildcard_constraints:
            sample=any_of(MEASURED),

    rule network_slab_parts:
        input:
            field=f"{TWIN}/slabs/network_basins_{{scatteritem}}.npz",
            pores=f"{TWIN}/slabs/network_pores_{{scatteritem}}.npz",
        output:
            field=temp(f"{TWIN}/slabs/network_parts_{{scatteritem}}.npz"),
            graph=temp(f"{TWIN}/slabs/network_parts_graph_{{scatteritem}}.npz"),
        log:
            f"{TWIN}/logs/network_parts_{{scatteritem}}.log",
        benchmark:
            f"{TWIN}/benchmarks/network_parts_{{scatteritem}}.tsv"
        conda:
            ENVS["analysis"]
        resources:
            mem_mb=memory(6000),
            runtime=runtime(60),
        params:
            science=science("network", "volume"),
        script:
            "../../scripts/network_parts.py"

    use rule network_slab_parts as reference_network_slab_parts with:
        input:
            field=f"{SAMPLE}/reference_network_basins_{{scatteritem}}.npz",
            pores=f"{SAMPLE}/reference_network_pores_{{scatteritem}}.npz",
        output:
            field=temp(f"{SAMPLE}/reference_network_parts_{{scatteritem}}.npz"),
            graph=temp(f"{SAMPLE}/reference_network_parts_graph_{{scatteritem}}.npz"),
        log:
            f"{SAMPLE}/logs/reference_network_parts_{{scatteritem}}.log",
        benchmark:
            f"{SAMPLE}/benchmarks/reference_network_parts_{{scatteritem}}.tsv"
        wildcard_constraints:
            sample=any_of(MEASURED),

    rule network_throats:
        input:
            graphs=gather.grainfall_slabs(
                f"{TWIN}/slabs/network_parts_graph_{{scatteritem}}.npz",
                allow_missing=True,
            ),
        output:
            asked=temp(
                scatter.grainfall_slabs(
                    f"{TWIN}/slabs/network_throats_{{scatteritem}}.npz",
                    allow_missing=True,
                )
            ),
            known=temp(f"{TWIN}/slabs/network_throats.npz"),
        log:
            f"{TWIN}/logs/network_throats.log",
        benchmark:
            f"{TWIN}/benchmarks/network_throats.tsv"
        conda:
            ENVS["analysis"]
        resources:
            mem_mb=memory(4000),
            runtime=runtime(30),
        params:
            science=science("network", "volume"),
        script:
            "../../scripts/network_throats.py"

    use rule network_throats as reference_network_throats with:
        input:
            graphs=gather.grainfall_slabs(
                f"{SAMPLE}/reference_network_parts_graph_{{scatteritem}}.npz",
                allow_missing=True,
            ),
        output:
            asked=temp(
                scatter.grainfall_slabs(
                    f"{SAMPLE}/reference_network_throats_{{scatteritem}}.npz",
                    allow_missing=True,
                )
            ),
            known=temp(f"{SAMPLE}/reference_network_throats.npz"),
        log:
            f"{SAMPLE}/logs/reference_network_throats.log",
        benchmark:
            f"{SAMPLE}/benchmarks/reference_network_throats.tsv"
        wildcard_constraints:
            sample=any_of(MEASURED),

    rule network_slab_measures:
        input:
            field=f"{TWIN}/slabs/network_parts_{{scatteritem}}.npz",
            asked=f"{TWIN}/slabs/network_throats_{{scatteritem}}.npz",
        output:
            measured=temp(f"{TWIN}/slabs/network_measures_{{scatteritem}}.npz"),
        log:
            f"{TWIN}/logs/network_measures_{{scatteritem}}.log",
        benchmark:
            f"{TWIN}/benchmarks/network_measures_{{scatteritem}}.tsv"
        conda:
            ENVS["analysis"]
        resources:
            mem_mb=memory(6000),
            runtime=runtime(60),
        params:
            science=science("network", "volume"),
        script:
            "../../scripts/network_measures.py"

    use rule network_slab_measures as reference_network_slab_measures with:
        input:
            field=f"{SAMPLE}/reference_network_parts_{{scatteritem}}.npz",
            asked=f"{SAMPLE}/reference_network_throats_{{scatteritem}}.npz",
        output:
            measured=temp(f"{SAMPLE}/reference_network_measures_{{scatteritem}}.npz"),
        log:
            f"{SAMPLE}/logs/reference_network_measures_{{scatteritem}}.log",
        benchmark:
            f"{SAMPLE}/benchmarks/reference_network_measures_{{scatteritem}}.tsv"
        wildcard_constraints:
            sample=any_of(MEASURED),

    rule network_joined:
        input:
            volume=f"{TWIN}/twin.zarr.zip",
            known=f"{TWIN}/slabs/network_throats.npz",
            measured=gather.grainfall_slabs(
                f"{TWIN}/slabs/network_measures_{{scatteritem}}.npz",
                allow_missing=True,
            ),
        output:
            pores=f"{TWIN}/network_pores.csv",
            throats=f"{TWIN}/network_throats.csv",
            record=f"{TWIN}/logs/network.json",
        log:
            f"{TWIN}/logs/network.log",
        benchmark:
            f"{TWIN}/benchmarks/network.tsv"
        wildcard_constraints:
            variant=any_of(BY_SLABS),
        conda:
            ENVS["analysis"]
        resources:
            mem_mb=memory(2000),
            runtime=runtime(10),
        params:
            settings=settings("network"),
            science=science("network", "volume"),
        script:
            "../../scripts/network_joined.py"

    use rule network_joined as reference_network_joined with:
        input:
            volume=f"{SAMPLE}/reference.zarr.zip",
            known=f"{SAMPLE}/reference_network_throats.npz",
            measured=gather.grainfall_slabs(
                f"{SAMPLE}/reference_network_measures_{{scatteritem}}.npz",
                allow_missing=True,
            ),
        output:
            pores=f"{SAMPLE}/reference_network_pores.csv",
            throats=f"{SAMPLE}/reference_network_throats.csv",
            record=f"{SAMPLE}/logs/reference_network.json",
        log:
            f"{SAMPLE}/logs/reference_network.log",
        benchmark:
            f"{SAMPLE}/benchmarks/reference_network.tsv"
        wildcard_constraints:
            sample=any_of(
                MEASURED if CONFIG["network"]["method"] == "persistence" else []
            ),


# What is solved on all voxels may take hours: a job a method, which neither another method nor the network touches.
rule flow_on_voxels:
    input:
        volume=f"{TWIN}/twin.zarr.zip",
    output:
        flow=f"{TWIN}/flow/{{method}}.csv",
    log:
        f"{TWIN}/logs/flow_{{method}}.log",
    benchmark:
        f"{TWIN}/benchmarks/flow_{{method}}.tsv"
    conda:
        ENVS["analysis"]
    resources:
        mem_mb=memory(8000),
        runtime=runtime(120),
    params:
        methods=the_method,
        settings=settings("network.coarsen"),
        science=science("flow", "volume"),
    script:
        "../../scripts/flow.py"


use rule flow_on_voxels as reference_flow_on_voxels with:
    input:
        volume=f"{SAMPLE}/reference.zarr.zip",
    output:
        flow=f"{SAMPLE}/reference_flow/{{method}}.csv",
    log:
        f"{SAMPLE}/logs/reference_flow_{{method}}.log",
    benchmark:
        f"{SAMPLE}/benchmarks/reference_flow_{{method}}.tsv"
    wildcard_constraints:
        sample=any_of(MEASURED),


rule flow:
    input:
        volume=f"{TWIN}/twin.zarr.zip",
        pores=f"{TWIN}/network_pores.csv",
        throats=f"{TWIN}/network_throats.csv",
        on_voxels=solved_on_voxels(f"{TWIN}/flow/{{method}}.csv"),
    output:
        flow=f"{TWIN}/flow.csv",
    log:
        f"{TWIN}/logs/flow.log",
    benchmark:
        f"{TWIN}/benchmarks/flow.tsv"
    conda:
        ENVS["analysis"]
    threads: many_threads
    resources:
        mem_mb=memory(8000),
        runtime=runtime(120),
    params:
        methods=methods_of_variant,
        settings=settings("network", "flow.conductance"),
        science=science("flow", "volume"),
    script:
        "../../scripts/flow.py"


use rule flow as reference_flow with:
    input:
        volume=f"{SAMPLE}/reference.zarr.zip",
        pores=f"{SAMPLE}/reference_network_pores.csv",
        throats=f"{SAMPLE}/reference_network_throats.csv",
        on_voxels=solved_on_voxels(f"{SAMPLE}/reference_flow/{{method}}.csv"),
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
        library=ancient(f"{SAMPLE}/grains3d"),
        library_record=f"{SAMPLE}/logs/grain_library.json",
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
        settings=settings("contacts.tolerance", "packing", "effects.decomposition"),
        science=science("contacts", "packing"),
    script:
        "../../scripts/contacts.py"


rule resettling:
    input:
        scene=f"{VARIANT}/scene.json",
        library=ancient(f"{SAMPLE}/grains3d"),
        library_record=f"{SAMPLE}/logs/grain_library.json",
        first_report=f"{TWIN}/first/packing.json",
        packed=f"{TWIN}/second/bodies.csv",
        packing=f"{TWIN}/second/packing.json",
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
        settings=settings("packing", "effects.decomposition"),
        science=science("packing", "volume", "correlation"),
    script:
        "../../scripts/resettling.py"
