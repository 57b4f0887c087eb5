// Of the whole backbone, whatever the host does:
//
// - status and interrupt never announce a step whose results are not all written (PROVE_STATUS);
// - no address leaves its region, nor the memory behind it (PROVE_ADDRESSES).
//
// PROPERTY_ONLY leaves out the lemmas, so that what a broken design violates is the property itself.
module backbone_proof
  import pearl_pkg::*;
#(
    // Those of pearl_backbone that are not its defaults.
    parameter int unsigned N_ENVS = 40,
    parameter int unsigned PE_NUM = 8,
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned WORD_ADDR_BITS = 14
) (
    input logic                      clk_i,
    input logic                      req_i,
    input logic                      we_i,
    input logic [WORD_ADDR_BITS-1:0] addr_i,
    input logic [       DATA_WL-1:0] wdata_i
);

  // As the backbone demands: reset lasts LATENCY + 4 cycles.
  localparam int unsigned RESET_CYCLES = pearl_core_pkg::LATENCY + 4;
  logic [7:0] age_q = '0;
  logic rst_n;
  assign rst_n = age_q == 8'(RESET_CYCLES);
  always_ff @(posedge clk_i) if (!rst_n) age_q <= age_q + 1'b1;

  logic irq, unused_rvalid;
  logic [DATA_WL-1:0] unused_rdata;
  resp_e unused_resp;

  pearl_backbone #(
      .N_ENVS(N_ENVS),
      .PE_NUM(PE_NUM),
      .DATA_WL(DATA_WL),
      .WORD_ADDR_BITS(WORD_ADDR_BITS)
  ) u_backbone (
      .clk_i,
      .rst_ni  (rst_n),
      .req_i,
      .we_i,
      .addr_i,
      .wdata_i,
      .rvalid_o(unused_rvalid),
      .rdata_o (unused_rdata),
      .resp_o  (unused_resp),
      .irq_o   (irq)
  );

`ifdef PROVE_STATUS
  localparam int unsigned OBS_WORDS = stream_words(N_ENVS, pearl_core_pkg::OBS_BITS, DATA_WL);
  localparam int unsigned REWARD_WORDS = stream_words(N_ENVS, pearl_core_pkg::REWARD_BITS, DATA_WL);
  localparam int unsigned TER_WORDS = stream_words(N_ENVS, TER_BITS, DATA_WL);
  localparam int unsigned RUNNING = 2;

  // Which words of each result memory were written in this step: seen at the memories' ports.
  logic [OBS_WORDS-1:0] obs_q;
  logic [REWARD_WORDS-1:0] rewards_q;
  logic [TER_WORDS-1:0] ters_q;
  // What was true a cycle ago.
  logic irq_q, all_written_q, awake_q;
  logic [31:0] finished_q;

  logic clear;
  assign clear = !rst_n || u_backbone.ring || u_backbone.start;

  always_ff @(posedge clk_i) begin
    if (clear) obs_q <= '0;
    else if (u_backbone.u_observations.we) obs_q[u_backbone.u_observations.waddr] <= 1'b1;
    if (clear) rewards_q <= '0;
    else if (u_backbone.u_rewards.we) rewards_q[u_backbone.u_rewards.waddr] <= 1'b1;
    if (clear) ters_q <= '0;
    else if (u_backbone.u_ters.we) ters_q[u_backbone.u_ters.waddr] <= 1'b1;
    awake_q <= rst_n;
    irq_q <= irq;
    finished_q <= u_backbone.u_registers.finished_q;
    all_written_q <= &obs_q && &rewards_q && &ters_q;
  end

  always_ff @(posedge clk_i) begin
    if (rst_n && awake_q) begin
      if (u_backbone.u_registers.finished_q != finished_q) assert (all_written_q);
      if (irq && !irq_q) assert (all_written_q);
      if (u_backbone.busy) begin
        assert (u_backbone.u_registers.finished_q != u_backbone.u_registers.rung_q);
        assert (!irq);
      end
    end
  end

`ifndef PROPERTY_ONLY
  always_ff @(posedge clk_i) begin
    if (rst_n) begin
      assert (32'(u_backbone.u_sequencer.state_q) <= RUNNING);
      if (!u_backbone.busy) assert (u_backbone.u_registers.finished_q == u_backbone.u_registers.rung_q);
      if (32'(u_backbone.u_sequencer.state_q) == RUNNING) begin
        assert (33'(obs_q) + 33'b1 == 33'b1 << u_backbone.u_observations.u_packer.count_q);
        assert (33'(rewards_q) + 33'b1 == 33'b1 << u_backbone.u_rewards.u_packer.count_q);
        assert (33'(ters_q) + 33'b1 == 33'b1 << u_backbone.u_ters.u_packer.count_q);
      end
    end
  end
`endif
`endif

`ifdef PROVE_ADDRESSES

  for (genvar i = 0; i < NumRegions; i++) begin : gen_region
    localparam int unsigned OFFSET = pearl_map_pkg::region_offset(i, N_ENVS, PE_NUM, DATA_WL);
    localparam int unsigned WORDS = pearl_map_pkg::region_words(i, N_ENVS, PE_NUM, DATA_WL);
    always_ff @(posedge clk_i) begin
      if (rst_n && (u_backbone.host_re[i] || u_backbone.host_we[i])) begin
        // It is the region that the host meant, and no other one.
        assert (32'(u_backbone.host_index) + OFFSET == 32'(u_backbone.u_port.addr_q));
        assert (32'(u_backbone.host_index) < WORDS);
        assert ((u_backbone.host_re | u_backbone.host_we) == NumRegions'(1) << i);
      end
    end
  end

  bind pearl_ram ram_proof #(
      .ADDR_BITS(ADDR_BITS),
      .DEPTH(DEPTH)
  ) u_proof (.*);

`ifndef PROPERTY_ONLY
  localparam int unsigned GROUPS = ceil_div(N_ENVS, PE_NUM);

  always_ff @(posedge clk_i) begin
    if (rst_n) begin
      if (u_backbone.u_group_reader.active_q) assert (32'(u_backbone.issue_group) < GROUPS);
      assert (32'(u_backbone.u_actions.u_unpacker.count_q) <= u_backbone.ACTION_WORDS);
      assert (32'(u_backbone.u_reset_mask.u_unpacker.count_q) <= u_backbone.MASK_WORDS);
      assert (32'(u_backbone.u_observations.u_packer.count_q) <= u_backbone.OBS_WORDS);
      assert (32'(u_backbone.u_rewards.u_packer.count_q) <= u_backbone.REWARD_WORDS);
      assert (32'(u_backbone.u_ters.u_packer.count_q) <= u_backbone.TER_WORDS);
    end
  end
`endif
`endif

endmodule
