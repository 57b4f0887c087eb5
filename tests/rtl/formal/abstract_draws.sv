// SPDX-License-Identifier: MIT
// Keys that are any, and there whenever they are; a draw in which slot and keys can be told apart, and
// nothing is multiplied. What they are in truth, a bench compares with pearl_marl/golden/rng.py.
module pearl_rng #(
    parameter int unsigned DRAWS = 1,
    // Of no effect: the keys are any, whatever their indices.
    parameter int unsigned FIRST = 0
) (
    input  logic                   clk_i,
    input  logic                   rst_ni,
    input  logic                   restart_i,
    input  logic                   next_i,
    input  logic [      1:0][31:0] seed_i,
    input  logic [     63:0]       tick_i,
    output logic                   valid_o,
    output logic [DRAWS-1:0][31:0] key_a_o,
    output logic [DRAWS-1:0][31:0] key_b_o
);

  logic [1:0][DRAWS-1:0][31:0] any_keys, keys_q;
  logic fixed_q = 1'b0;
  assign {key_a_o, key_b_o} = fixed_q ? keys_q : any_keys;

  always_ff @(posedge clk_i) begin
    fixed_q <= 1'b1;
    keys_q  <= {key_a_o, key_b_o};
  end

endmodule

module pearl_draw
  import pearl_pkg::*;
(
    input  logic        clk_i,
    input  logic [31:0] slot_i,
    input  logic [31:0] key_a_i,
    input  logic [31:0] key_b_i,
    output logic [31:0] draw_o
);

  pearl_delay #(
      .WIDTH (32),
      .STAGES(DRAW_LATENCY)
  ) u_delay (
      .clk_i,
      .d_i(slot_i ^ key_a_i ^ {key_b_i[0], key_b_i[31:1]}),
      .d_o(draw_o)
  );

endmodule
