// The keys of the random draws of one step (`key` of pearl_marl/rng.py): a chain of mix32 over seed,
// tick and draw index, once with each of two initial values.
//
// One multiplier pair serves both chains, and a round takes two cycles, one for each multiplier: so
// the keys take 4 * (4 + DRAWS) cycles. That is hidden: they are made anew as soon as seed or tick
// change, which is right after a step, not before one.
module pearl_rng
  import pearl_pkg::*;
#(
    // Draws of a slot in a step.
    parameter int unsigned DRAWS = 1
) (
    input  logic                   clk_i,
    input  logic                   rst_ni,
    // In the cycle in which seed_i or tick_i are new.
    input  logic                   restart_i,
    input  logic [      1:0][31:0] seed_i,
    input  logic [     63:0]       tick_i,
    output logic                   valid_o,
    output logic [DRAWS-1:0][31:0] key_a_o,
    output logic [DRAWS-1:0][31:0] key_b_o
);

  // The rounds that all draws share: two words of seed, two of tick.
  localparam int unsigned SHARED_ROUNDS = 4;
  localparam int unsigned ROUNDS = SHARED_ROUNDS + DRAWS;
  localparam int unsigned ROUND_BITS = $clog2(ROUNDS);

  logic valid_q, chain_q, half_q;
  logic [ROUND_BITS-1:0] round_q;
  logic [31:0] first_q, shared_q, word, mixed;
  logic [1:0][DRAWS-1:0][31:0] keys_q;

  always_comb begin
    unique case (32'(round_q))
      0: word = (chain_q ? CHAIN_B : CHAIN_A) ^ seed_i[0];
      1: word = shared_q ^ seed_i[1];
      2: word = shared_q ^ tick_i[63:32];
      3: word = shared_q ^ tick_i[31:0];
      default: word = shared_q ^ (32'(round_q) - SHARED_ROUNDS);
    endcase
  end

  assign mixed = mix_last(mix_second(first_q));

  always_ff @(posedge clk_i) begin
    first_q <= mix_first(word);
    if (half_q && !valid_q) begin
      if (32'(round_q) < SHARED_ROUNDS) shared_q <= mixed;
      for (int unsigned i = 0; i < DRAWS; i++) begin
        if (32'(round_q) == SHARED_ROUNDS + i) keys_q[chain_q][i] <= mixed;
      end
    end
  end

  always_ff @(posedge clk_i or negedge rst_ni) begin
    if (!rst_ni) begin
      valid_q <= 1'b0;
      chain_q <= 1'b0;
      half_q  <= 1'b0;
      round_q <= '0;
    end else if (restart_i) begin
      valid_q <= 1'b0;
      chain_q <= 1'b0;
      half_q  <= 1'b0;
      round_q <= '0;
    end else if (!valid_q) begin
      half_q <= !half_q;
      if (half_q) begin
        round_q <= round_q + 1'b1;
        if (32'(round_q) == ROUNDS - 1) begin
          round_q <= '0;
          chain_q <= 1'b1;
          valid_q <= chain_q;
        end
      end
    end
  end

  assign valid_o = valid_q;
  assign key_a_o = keys_q[0];
  assign key_b_o = keys_q[1];

endmodule
