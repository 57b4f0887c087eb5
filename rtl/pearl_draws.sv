// SPDX-License-Identifier: MIT
// The random draws of a step: its keys, and what every slot of a group draws under them.
module pearl_draws
  import pearl_pkg::*;
#(
    parameter  int unsigned PE_NUM = 4,
    parameter  int unsigned DRAWS  = 1,
    // The index of the first.
    parameter  int unsigned FIRST  = 0,
    localparam int unsigned WORDS  = DRAWS == 0 ? 1 : DRAWS
) (
    input  logic                               clk_i,
    input  logic                               rst_ni,
    // In the cycle in which seed_i or tick_i are new; in which tick_i is the next one.
    input  logic                               restart_i,
    input  logic                               next_i,
    input  logic [       1:0][     31:0]       seed_i,
    input  logic [      63:0]                  tick_i,
    // The keys are there.
    output logic                               valid_o,
    // The global number of the group's first slot, and DRAW_LATENCY cycles later what it draws.
    input  logic [      31:0]                  slot_i,
    output logic [PE_NUM-1:0][WORDS-1:0][31:0] draws_o
);

  if (DRAWS == 0) begin : gen_none
    logic unused;
    assign unused  = ^{clk_i, rst_ni, restart_i, next_i, seed_i, tick_i, slot_i};
    assign valid_o = 1'b1;
    assign draws_o = '0;
  end else begin : gen_draws
    logic [DRAWS-1:0][31:0] key_a, key_b;

    pearl_rng #(
        .DRAWS(DRAWS),
        .FIRST(FIRST)
    ) u_rng (
        .clk_i,
        .rst_ni,
        .restart_i,
        .next_i,
        .seed_i,
        .tick_i,
        .valid_o,
        .key_a_o(key_a),
        .key_b_o(key_b)
    );

    pearl_draw_row #(
        .PE_NUM(PE_NUM),
        .DRAWS (DRAWS)
    ) u_row (
        .clk_i,
        .slot_i,
        .key_a_i(key_a),
        .key_b_i(key_b),
        .draws_o
    );
  end

endmodule
