// SPDX-License-Identifier: MIT
// PE_NUM processing elements side by side, and the padding of the last group masked out.
module pearl_pe_array
  import pearl_pkg::*;
  import pearl_core_pkg::*;
#(
    parameter int unsigned N_ENVS = 7,
    parameter int unsigned PE_NUM = 4
) (
    input logic                                                    clk_i,
    input logic                                                    rst_ni,
    input logic                                                    valid_i,
    // The group is only to show what its step starts from.
    input logic                                                    observe_i,
    input mode_t                                                   mode_i,
    input logic                                                    limited_i,
    input logic  [ELAPSED_BITS-1:0]                                limit_i,
    input logic  [      PE_NUM-1:0][TER_BITS+STATE_BITS-1:0]       states_i,
    input logic  [      PE_NUM-1:0][         STATE_BITS-1:0]       inits_i,
    input logic  [      PE_NUM-1:0]                                resets_i,
    input logic  [      PE_NUM-1:0][        ACTION_BITS-1:0]       actions_i,
    input logic  [      PE_NUM-1:0][          RNG_WORDS-1:0][31:0] rng_i,

    // LATENCY cycles after valid_i.
    input  logic [PE_NUM-1:0][ELAPSED_BITS-1:0] elapsed_i,
    output logic [PE_NUM-1:0][ELAPSED_BITS-1:0] elapsed_o,

    // LATENCY + 1 cycles after valid_i, when valid_late_i and last_late_i are what valid_i and "this is
    // the last group" were.
    input  logic                                       valid_late_i,
    input  logic                                       last_late_i,
    output logic [PE_NUM-1:0][TER_BITS+STATE_BITS-1:0] states_o,
    output logic [PE_NUM-1:0][           OBS_BITS-1:0] obs_o,
    output logic [PE_NUM-1:0][        REWARD_BITS-1:0] rewards_o,
    output logic [PE_NUM-1:0][           TER_BITS-1:0] ters_o,
    output logic [PE_NUM-1:0][             AGENTS-1:0] gone_o
);

  localparam int unsigned LAST_PES = (N_ENVS - 1) % PE_NUM + 1;

  logic [PE_NUM-1:0] core_valid;

  for (genvar i = 0; i < PE_NUM; i++) begin : gen_pe
    logic [OBS_BITS-1:0] obs;
    logic [REWARD_BITS-1:0] reward;
    logic [TER_BITS-1:0] ter;
    logic padding;

    pearl_pe u_pe (
        .clk_i,
        .rst_ni,
        .valid_i,
        .mode_i,
        .observe_i,
        .limited_i,
        .limit_i,
        .state_i(states_i[i][STATE_BITS-1:0]),
        .ter_i(states_i[i][STATE_BITS+:TER_BITS]),
        .init_i(inits_i[i]),
        .reset_i(resets_i[i]),
        .action_i(actions_i[i]),
        .rng_i(rng_i[i]),
        .elapsed_i(elapsed_i[i]),
        .elapsed_o(elapsed_o[i]),
        .valid_o(core_valid[i]),
        .state_o(states_o[i][STATE_BITS-1:0]),
        .obs_o(obs),
        .reward_o(reward),
        .ter_o(ter),
        .gone_o(gone_o[i])
    );

    assign padding = i >= LAST_PES && last_late_i;
    assign states_o[i][STATE_BITS+:TER_BITS] = ter;
    assign obs_o[i] = padding ? '0 : obs;
    assign rewards_o[i] = padding ? '0 : reward;
    assign ters_o[i] = padding ? '0 : ter;
  end

  always_ff @(posedge clk_i) begin
    if (rst_ni) begin
      assert (core_valid == {PE_NUM{valid_late_i}})
      else $error("pearl_pe_array: the core's valid_o does not keep the latency its package states");
    end
  end

endmodule
